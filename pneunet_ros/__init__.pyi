# The public API, listed once: `__init__.py` reads here where a name is imported from on first use.
from pneunet_ros.calibration.calibration import calibrate as calibrate
from pneunet_ros.calibration.calibration import Calibration as Calibration
from pneunet_ros.core.readings import PressureReading as PressureReading
from pneunet_ros.core.readings import TargetSightings as TargetSightings
from pneunet_ros.core.readings import WrenchReading as WrenchReading
from pneunet_ros.diagnosis.result import Diagnosis as Diagnosis
from pneunet_ros.estimation.estimate import ShapeEstimate as ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator as Estimator
from pneunet_ros.estimation.settings import EstimatorSettings as EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState as EstimatorState
from pneunet_ros.exploration.proposal import diagnose as diagnose
from pneunet_ros.files.model_file import load_model as load_model
from pneunet_ros.files.model_file import save_model as save_model
from pneunet_ros.fusion.estimate import FusedEstimate as FusedEstimate
from pneunet_ros.fusion.fusion import Fusion as Fusion
from pneunet_ros.fusion.settings import FusionSettings as FusionSettings
from pneunet_ros.fusion.state import FusionState as FusionState
from pneunet_ros.measurement.dataset import RecordingData as RecordingData
from pneunet_ros.model.arm import Arm as Arm
from pneunet_ros.model.batch import solve_many as solve_many
from pneunet_ros.model.equilibrium import solve as solve
from pneunet_ros.model.inverse import solve_tip as solve_tip
from pneunet_ros.model.shape import Shape as Shape
from pneunet_ros.recordings.dataset_reader import read_run as read_run
from pneunet_ros.vision.camera.camera_settings import CameraSettings as CameraSettings
from pneunet_ros.vision.tracker import Tracker as Tracker
from pneunet_ros.vision.tracker import TrackerState as TrackerState

__version__: str
