"""What all tests need: ROS of their own, no window, no leak into other Pythons."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import zlib

import hypothesis
from pneunet_ros.core.kernels.cache import kernels_are_cached
from pneunet_ros.core.threads import THREADS as NAMES_OF_THREADS
from pneunet_ros.core.threads import use_one_thread
import pytest

CHECKOUT = Path(__file__).resolve().parent.parent


def own_domain() -> int:
    """Return a ROS domain (1-101) for this process: one per worker, and others for another run."""
    run = os.environ.get('PYTEST_XDIST_TESTRUNUID', str(os.getpid()))
    worker = os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw')
    return (zlib.crc32(run.encode()) + int(worker)) % 101 + 1


# A shell starts background jobs with Ctrl-C ignored, and children would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Set before anything imports rclpy or matplotlib.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(own_domain())
os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='pneunet_ros_log_')
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
os.environ['MPLBACKEND'] = 'Agg'
# As commands and nodes: with more threads the last digits of what is compared with them differ.
use_one_thread()
THREADS = {name: os.environ[name] for name in NAMES_OF_THREADS}

# The first example may compile a kernel, so no deadline. CI draws the same examples every time.
hypothesis.settings.register_profile('local', deadline=None)
hypothesis.settings.register_profile('ci', deadline=None, derandomize=True)
hypothesis.settings.load_profile('ci' if os.environ.get('CI') else 'local')

# Files that `make quick` leaves out: they start processes, simulate films and recordings,
# calibrate or diagnose. None of the others takes 3 s of CPU.
LENGTHY = """
    atomic beam benches blobs bursts calibrate_verb calibration calibration_report camera_demo
    check cli clock_delay composed_pictures consistency contact demo_plot diagnose_verb
    diagnosis diagnosis_report effects estimator_topics evaluation experiment_node exploration
    explore_verb extending faults few_numbers few_targets film first_curvature
    frames_in_motion fuse_replay fusion fusion_motion fuzz_archives fuzz_files fuzz_messages
    fuzz_recordings fuzz_tables gaussian_model generic_field golden grasp help hypothesis
    kernel_cache lab_day lab_effects lab_live lab_renderer lack_of_fit left_out_recordings
    linearization localization map_estimation markers motion_fit named_effects noise_estimate
    odd_dots outside_effects packaging page_commands pages preview published reading_noise
    recorded_gravity recording_writer refit replay score_test simulate_verb simulation
    smoother solver stiffness_variation survey survey_verb tip_pose track tracker
    tracking_page user_effects uses working_plane_and_lens
"""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let pages be rewritten by what their commands print, and effects of a user be tested."""
    parser.addoption('--effects-path', help='folder of effect files, for test_effects.py')
    parser.addoption('--rewrite', action='store_true', help='rewrite outputs shown on pages')


def pytest_configure(config: pytest.Config) -> None:
    """Add the effects of a user to the table, and refuse a name in LENGTHY that is no file.

    One that was renamed would count as quick.
    """
    if config.getoption('--effects-path'):
        from pneunet_ros.effects.user_effects import add_effects

        add_effects(config.getoption('--effects-path'))
    here = Path(__file__).parent
    there = {path.stem.removeprefix('test_') for path in here.glob('*/test_*.py')}
    gone = [name for name in LENGTHY.split() if name not in there]
    assert not gone, f'LENGTHY in test/conftest.py names what is gone: {", ".join(gone)}'


def pytest_sessionstart(session: pytest.Session) -> None:
    """Have the kernels compiled, once: a verb that finds none starts a process that does.

    Tests would go on without them until then, and find that process at the end.
    """
    if not kernels_are_cached() and not hasattr(session.config, 'workerinput'):
        subprocess.run([sys.executable, '-m', 'pneunet_ros.cli', 'compile'], check=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark files that take long, and skip what is marked `ros` where there is no ROS."""
    lengthy, without_ros = LENGTHY.split(), not importlib.util.find_spec('rclpy')
    for item in items:
        if item.path.stem.removeprefix('test_') in lengthy:
            item.add_marker('lengthy')
        if without_ros and item.get_closest_marker('ros'):
            item.add_marker(pytest.mark.skip(reason="no rclpy here: pip install '.[ros]'"))


@pytest.fixture(autouse=True, scope='module')
def own_threads() -> None:
    """Give nodes and commands the threads of linear algebra that this process has.

    What one test sets must not reach the processes of another.
    """
    os.environ.update(THREADS)


@pytest.fixture(scope='session')
def checkout() -> Path:
    """Return the folder of the checkout."""
    return CHECKOUT


@pytest.fixture
def foreign_environment() -> dict[str, str]:
    """Environment for starting another Python: without what the ROS wheels set for this one."""
    ours = ('AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'PYTHONPATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE')
    return {key: value for key, value in os.environ.items() if key not in ours}
