"""Make the recording of a camera that looks at a bending arm, and the truth about its targets.

Everything is rendered by the virtual lab (see README.md):

    python bags/camera_demo/make_camera_demo.py
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import cache
import os
from pathlib import Path
import sys
import tempfile
from typing import Any

import cv2
import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.files.model_file import load_model
from pneunet_ros.lab.pictures.lens import overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer, Truth
from pneunet_ros.lab.pictures.scene import Dots, Glint, Label, Light, Occluder, Scene, Spot
from pneunet_ros.messages.readings import PRESSURE_TYPE
from pneunet_ros.recordings.bag_folder import METADATA
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording

# The tests know how a model's arm is put before the camera of the virtual lab.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'test'))
from support.camera_images import hand
from support.moving_arm import ArmMotion, motion_of, up_and_down

NAME, TRUTH = 'camera_demo', 'truth.csv'
IMAGE_TOPIC, IMAGE_TYPE = '/pneunet/image_raw/compressed', 'sensor_msgs/msg/CompressedImage'
INFO_TOPIC, INFO_TYPE = '/pneunet/camera_info', 'sensor_msgs/msg/CameraInfo'
PRESSURE_TOPIC = '/pneunet/pressure'
CAMERA_FRAME, PRESSURE_FRAME = 'camera', 'pressure_sensor'

SEED = 20160227
START_NS = NANOSECONDS_PER_SECOND
DURATION = 8.0  # s
IMAGES_PER_SECOND, PRESSURES_PER_SECOND = 30, 60
EXPOSURE = 0.008  # s
TOP = 50e3  # Pa
PRESSURE_STD = 60.0  # Pa, white noise of the sensor, as in config/paper_arm.yaml
JPEG_QUALITY = 85
HAND = (2.2, 4.0)  # s, when a hand comes in and is gone again

SCENE = Scene(
    camera=overhead_camera(
        width=640,
        height=480,
        focal_px=610.0,
        scale=0.00027,
        middle=(0.058, 0.032),
        distortion=(-0.25, 0.09, 0.0006, -0.0004, 0.0),
        roll=0.012,
    ),
    light=Light(level=0.97, gradient_u=-0.30, gradient_v=0.16, vignette=0.35),
    background=96.0,
    texture=1.5,
    seed=SEED,
    labels=(Label(u=520.0, v=418.0, width=104.0, height=46.0, angle=-0.07),),
    spots=(
        Spot(u=596.0, v=52.0, major=7.0, minor=4.0, angle=0.6),
        Spot(u=47.0, v=96.0, major=3.0, minor=3.0),
    ),
    decoys=Dots(x=0.022 + 0.005 * np.arange(5), y=np.full(5, -0.0165) + 0.0004 * np.arange(5)),
    glints=(
        Glint(u=356.0, v=322.0, major=9.0, minor=1.3, angle=-0.5),
        Glint(u=228.0, v=372.0, major=2.2, minor=1.6),
        Glint(u=454.0, v=214.0, major=5.0, minor=1.2, angle=1.1),
    ),
    blur=0.75,
    noise=0.85,
)


def stamps(per_second: int) -> list[int]:
    """Return stamps (ns) of a topic."""
    count = round(DURATION * per_second) + 1
    return [START_NS + index * NANOSECONDS_PER_SECOND // per_second for index in range(count)]


def pressure_at(stamp_ns: float) -> float:
    """Return the pressure (Pa) in the arm: at rest for a second, up to TOP, and back."""
    time = (stamp_ns - START_NS) / NANOSECONDS_PER_SECOND
    return up_and_down(time, rest=1.0, rise=3.0, hold=0.4, top=TOP)


def hand_at(stamp_ns: int) -> tuple[Occluder, ...]:
    """Return the hand that reaches into the image from the right, over some targets, and back."""
    time = (stamp_ns - START_NS) / NANOSECONDS_PER_SECOND
    share = (time - HAND[0]) / (HAND[1] - HAND[0])
    if not 0.0 < share < 1.0:
        return ()
    reach = np.sin(np.pi * share)
    return hand(770.0 - 450.0 * reach, 130.0 + 90.0 * share, 120.0, np.pi + 0.25 - 0.3 * share)


@cache
def motion() -> ArmMotion:
    """Return the arm of the paper, unloaded."""
    return motion_of(load_model(share_path('config/paper_arm.yaml')), (0.0, TOP))


@cache
def renderer() -> Renderer:
    """Return the scene, ready."""
    return Renderer(SCENE)


def picture(index: int) -> tuple[Any, Truth]:
    """Return an image (480, 640), grey, and its truth; its stamp is the middle of its exposure."""
    stamp = stamps(IMAGES_PER_SECOND)[index]
    half = 0.5 * EXPOSURE * NANOSECONDS_PER_SECOND
    moment = motion().frame_state(
        pressure_at(stamp), pressure_at(stamp - half), pressure_at(stamp + half), hand_at(stamp)
    )
    return renderer().render(moment, np.random.default_rng([SEED, index]))


def truth_lines(stamp_ns: int, truth: Truth) -> Iterator[str]:
    """Yield a line of truth.csv for every target of an image."""
    columns = (truth.u, truth.v, truth.x, truth.y, truth.visible)
    for index, (u, v, x, y, visible) in enumerate(zip(*columns, strict=True)):
        yield f'{stamp_ns},{index},{u:.3f},{v:.3f},{x:.7f},{y:.7f},{visible:.3f}\n'


def readings() -> Iterator[tuple[int, float]]:
    """Yield stamp (ns) and pressure (Pa) as the sensor reports it."""
    noise = np.random.default_rng(SEED)
    for stamp in stamps(PRESSURES_PER_SECOND):
        yield stamp, pressure_at(stamp) + PRESSURE_STD * float(noise.standard_normal())


def header(stamp_ns: int, frame_id: str) -> Any:
    """Return a Header with this stamp."""
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    stamp = ROSBAGS_TYPES('builtin_interfaces/msg/Time')(sec=seconds, nanosec=nanoseconds)
    return ROSBAGS_TYPES('std_msgs/msg/Header')(stamp=stamp, frame_id=frame_id)


def image_message(stamp_ns: int, grey: Any) -> Any:
    """Return a CompressedImage of a grey image."""
    _, data = cv2.imencode('.jpg', grey, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return ROSBAGS_TYPES(IMAGE_TYPE)(
        header=header(stamp_ns, CAMERA_FRAME), format='jpeg', data=np.asarray(data).reshape(-1)
    )


def info_message(stamp_ns: int) -> Any:
    """Return the CameraInfo of the camera."""
    camera = SCENE.camera
    region = ROSBAGS_TYPES('sensor_msgs/msg/RegionOfInterest')(
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return ROSBAGS_TYPES(INFO_TYPE)(
        header=header(stamp_ns, CAMERA_FRAME),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.model,
        d=camera.distortion,
        k=camera.matrix.reshape(-1),
        r=np.eye(3).reshape(-1),
        p=np.hstack([camera.matrix, np.zeros((3, 1))]).reshape(-1),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def pressure_message(stamp_ns: int, pressure: float) -> Any:
    """Return a FluidPressure of unknown variance."""
    return ROSBAGS_TYPES(PRESSURE_TYPE)(
        header=header(stamp_ns, PRESSURE_FRAME), fluid_pressure=pressure, variance=0.0
    )


def make(folder: Path) -> None:
    """Write the recording as a rosbag2 folder, which must not exist yet, with the truth in it."""
    events = [(stamp, 1, pressure) for stamp, pressure in readings()]
    events += [(stamp, 0, index) for index, stamp in enumerate(stamps(IMAGES_PER_SECOND))]
    truth = ['stamp_ns,id,u,v,x,y,visible\n']
    with write_recording(folder) as writer:
        images = writer.add(IMAGE_TOPIC, IMAGE_TYPE)
        infos = writer.add(INFO_TOPIC, INFO_TYPE)
        pressures = writer.add(PRESSURE_TOPIC, PRESSURE_TYPE)
        for stamp, kind, value in sorted(events):
            if kind:
                writer.write(pressures, stamp, pressure_message(stamp, value))
                continue
            grey, true = picture(value)
            truth.extend(truth_lines(stamp, true))
            # The camera first: an image is read with the camera known by then.
            writer.write(infos, stamp, info_message(stamp))
            writer.write(images, stamp, image_message(stamp, grey))
    (folder / TRUTH).write_text(''.join(truth), encoding='utf-8')


def main() -> None:
    """Make the recording beside this script, or where the command line says."""
    parser = argparse.ArgumentParser(description='Make the recording of a camera and its truth.')
    parser.add_argument('--output', type=Path, default=Path(__file__).resolve().parent)
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    # This folder also holds the script and its README, which stay.
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        made = Path(scratch) / NAME
        make(made)
        for file in (f'{NAME}.mcap', METADATA, TRUTH):
            os.replace(made / file, folder / file)


if __name__ == '__main__':
    main()
