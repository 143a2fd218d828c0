"""Install by `pip install .` (commands in bin/) or by `colcon build` (in lib/pneunet_ros/)."""

from pathlib import Path
import re
import sys

from setuptools import find_packages, setup

PACKAGE = 'pneunet_ros'
SHARE = f'share/{PACKAGE}'
# Of the recordings the one of `pneunet demo` alone: the others are megabytes, for a checkout.
SHIPPED = ('config', 'launch', 'rviz', 'foxglove', 'plotjuggler', 'bags/table1', 'scenarios')
NODES = ('estimator', 'tracker', 'fusion', 'virtual_arm', 'gripper', 'virtual_gripper')


def shipped_files():
    """(folder below the install prefix, files) for all that is installed beside the code."""
    yield 'share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']
    yield SHARE, ['package.xml']
    files = [file for top in SHIPPED for file in sorted(Path(top).rglob('*')) if file.is_file()]
    for file in files:
        if '__pycache__' not in file.parts:
            yield f'{SHARE}/{file.parent.as_posix()}', [str(file)]


def commands():
    """Commands and what they call.

    Colcon keeps the commands of a package in a folder, where `ros2 run` looks.
    pip puts them on everybody's PATH, so there they carry the name of the package.
    """
    stack = 'pneunet_ros.nodes.stack:main'
    nodes = {node: f'pneunet_ros.nodes.{node}.__main__:main' for node in NODES}
    if {'install', 'develop'} & set(sys.argv):  # colcon and bloom; pip asks for a wheel
        named = {**nodes, 'pneunet_stack': stack}
    else:
        named = {f'pneunet-{node.replace("_", "-")}': main for node, main in nodes.items()}
        named['pneunet-stack'] = stack
    named = {'pneunet': 'pneunet_ros.cli.__main__:main', **named}
    return [f'{name} = {main}' for name, main in named.items()]


def long_description():
    """README.md without what leads to other files: no index of packages has these."""
    text = Path('README.md').read_text(encoding='utf-8')
    text = re.sub(r'!\[([^]]*)\]\((?!https?:)[^)]*\)\n*', '', text)
    return re.sub(r'\[([^]]+)\]\((?!https?:)[^)]*\)', r'\1', text)


# What `make demo` installs and runs with; it and readings need no OpenCV.
READINGS = [
    'lz4>=4.0',
    'matplotlib>=3.6',
    'mcap>=1.2',
    'numba>=0.58',
    'numpy>=1.26',
    'rich>=13',
    'rosbags>=0.11.7',
    'ruamel.yaml>=0.17',
    'scipy>=1.11',
    'zstandard>=0.22',
]
CLUSTER = ['distributed>=2024.2']
MUJOCO = ['mujoco>=3.13']  # the first with the integrator `discrete`
TEST = [
    *CLUSTER,
    *MUJOCO,
    'hypothesis>=6.98',
    'pytest>=7.4',
    # The photographs that they ship, on which pictures are composed.
    'scikit-image>=0.22',
    'scikit-learn>=1.4',
]
DOCS = ['furo>=2024.1', 'myst-parser>=3', 'sphinx>=7.2']
# The wheels of ROS 2 Jazzy exist for Linux on x86-64; elsewhere ROS comes from its own packages.
WHEELS = 'sys_platform == "linux" and platform_machine == "x86_64" and python_version < "3.14"'

setup(
    name=PACKAGE,
    # This line and <version> in package.xml are those that `catkin_prepare_release` rewrites.
    version='0.1.0',
    description='Shape of a pneumatic soft arm (PneuNet) from its pressure and its end load',
    long_description=long_description(),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    license_files=['LICENSE'],
    keywords=['soft robotics', 'pneu-net', 'rod model', 'calibration', 'ROS 2'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3 :: Only',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Topic :: Scientific/Engineering :: Physics',
        'Typing :: Typed',
    ],
    maintainer='pneunet_ros maintainers',
    maintainer_email='maintainers@pneunet.invalid',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed', '__init__.pyi', 'reports/templates/*']},
    data_files=list(shipped_files()),
    python_requires='>=3.11',
    install_requires=[*READINGS, 'jinja2>=3.1', 'opencv-python-headless>=4.6'],
    extras_require={
        'ros': [
            f'ros-jazzy-rclpy; {WHEELS}',
            f'ros-rclpy[fastrtps]==7.1.6; {WHEELS}',
            f'ros-jazzy-common-interfaces; {WHEELS}',
        ],
        'cluster': CLUSTER,
        'mujoco': MUJOCO,
        'completion': ['argcomplete>=2'],
        'docs': DOCS,
        'test': TEST,
        'dev': [
            *DOCS,
            *TEST,
            'argcomplete>=2',
            'pytest-xdist>=3.4',
            'import-linter>=2.5',
            'mypy>=2.4,<2.5',
            'ruff>=0.17,<0.18',
            'setuptools>=68',
        ],
    },
    zip_safe=True,
    entry_points={'console_scripts': commands()},
)
