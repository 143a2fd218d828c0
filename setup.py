"""Install by `pip install .` (commands in bin/) or by `colcon build` (in lib/pneunet_ros/)."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'pneunet_ros'
SHARE = f'share/{PACKAGE}'
SHIPPED = ('config', 'launch', 'rviz', 'foxglove', 'plotjuggler', 'bags', 'scenarios')


def shipped_files():
    """(folder below the install prefix, files) for all that is installed beside the code."""
    yield 'share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']
    yield SHARE, ['package.xml']
    files = [file for top in SHIPPED for file in sorted(Path(top).rglob('*')) if file.is_file()]
    for file in files:
        if '__pycache__' not in file.parts:
            yield f'{SHARE}/{file.parent.as_posix()}', [str(file)]


CLUSTER = ['distributed>=2024.2']
TEST = [
    *CLUSTER,
    'hypothesis>=6.98',
    'pytest>=7.4',
    # The photographs that they ship, on which pictures are composed.
    'scikit-image>=0.22',
    'scikit-learn>=1.4',
]
# The wheels of ROS 2 Jazzy exist for Linux on x86-64; elsewhere ROS comes from its own packages.
WHEELS = 'sys_platform == "linux" and platform_machine == "x86_64" and python_version < "3.14"'

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Shape of a pneumatic soft arm (PneuNet) from its pressure and its end load',
    license='Apache-2.0',
    maintainer='pneunet_ros maintainers',
    maintainer_email='maintainers@pneunet.invalid',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed', '__init__.pyi', 'reports/templates/*']},
    data_files=list(shipped_files()),
    python_requires='>=3.11',
    install_requires=[
        'jinja2>=3.1',
        'lz4>=4.0',
        'matplotlib>=3.6',
        'mcap>=1.2',
        'numba>=0.58',
        'numpy>=1.26',
        'opencv-python-headless>=4.6',
        'rich>=13',
        'rosbags>=0.11.7',
        'ruamel.yaml>=0.17',
        'scipy>=1.11',
        'zstandard>=0.22',
    ],
    extras_require={
        'ros': [
            f'ros-jazzy-rclpy; {WHEELS}',
            f'ros-rclpy[fastrtps]==7.1.6; {WHEELS}',
            f'ros-jazzy-common-interfaces; {WHEELS}',
        ],
        'cluster': CLUSTER,
        'test': TEST,
        'dev': [
            *TEST,
            'pytest-xdist>=3.4',
            'import-linter>=2.5',
            'mypy>=2.4,<2.5',
            'ruff>=0.17,<0.18',
            'setuptools>=68',
        ],
    },
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'pneunet = pneunet_ros.cli.__main__:main',
            'estimator = pneunet_ros.nodes.estimator.__main__:main',
            'tracker = pneunet_ros.nodes.tracker.__main__:main',
            'virtual_arm = pneunet_ros.nodes.virtual_arm.__main__:main',
            'pneunet_stack = pneunet_ros.nodes.stack:main',
        ],
    },
)
