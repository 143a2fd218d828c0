"""A fleet of real arms for `pneunet survey`: 27 pneumatic actuators, clamp and tip.

    python acceptance/survey_real_data.py FOLDER [--data TABLE.csv] [--noise PERCENT]
    pneunet survey FOLDER --static --output DIR

Every actuator of `acceptance/real_data.py` becomes a folder with an arm of constant curvature and
two recordings without a load, of two targets: every third pressure between the first and the last
is held out. Assumed is what that script assumes; the noise of a tip is given, not measured, and
frames are put 10 s apart, which is invented, hence `--static`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.files.model_file import save_model
from pneunet_ros.messages.readings import PRESSURE, TARGETS
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording
from real_data_diagnosis import KEPT_OUT, model, NOISE, PERIOD
from real_data_fit import Actuator, ASSUMED, DATA, read_actuators


def write_fleet(actuators: Iterable[Actuator], folder: Path, noise: float) -> list[Path]:
    """Write a folder per actuator; return them. noise: of a tip, % of the length."""
    places = []
    for actuator in actuators:
        place = folder / actuator.name
        place.mkdir(parents=True)
        save_model(model(actuator, noise), place / 'arm.yaml')
        every = np.arange(actuator.pressure.size)
        kept_out = every[KEPT_OUT]
        write(actuator, np.setdiff1d(every, kept_out), place / 'unloaded.mcap')
        if kept_out.size:
            write(actuator, kept_out, place / 'heldout.mcap')
        places.append(place)
    return places


def write(actuator: Actuator, rows: np.ndarray, path: Path) -> None:
    """Write the recording of some of the rows."""
    with write_recording(path) as writer:
        topics = {
            sensor.name: writer.add(f'/pneunet/{sensor.name}', sensor.type)
            for sensor in (PRESSURE, TARGETS)
        }
        for row in rows.tolist():
            stamp = PERIOD * (1 + row)
            tip = actuator.tip[row]
            values = {
                PRESSURE: np.array([actuator.pressure[row]]),
                TARGETS: np.array([[0.0, tip[0]], [0.0, tip[1]]]),
            }
            for sensor, value in values.items():
                message = sensor.message(stamp, value, BASE_FRAME, ROSBAGS_TYPES)
                writer.write(topics[sensor.name], stamp, message)


def main() -> None:
    """Write, and say what to do with it."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('folder', type=Path, help='output folder, which must not exist')
    command.add_argument('--data', type=Path, default=DATA, help=f'the table (default: {DATA})')
    command.add_argument(
        '--noise',
        type=float,
        default=NOISE,
        help='noise of a tip, %% of the length (default: %(default)s)',
    )
    arguments = command.parse_args()
    if arguments.folder.exists():
        command.exit(2, f'{arguments.folder} exists already: choose another name\n')
    try:
        places = write_fleet(read_actuators(arguments.data), arguments.folder, arguments.noise)
    except PneunetError as error:
        command.exit(2, f'{error}\n')
    print(f'wrote {len(places)} arms into {arguments.folder} ({ASSUMED})')
    print(f'pneunet survey {arguments.folder} --static --output DIR')


if __name__ == '__main__':
    main()
