"""Process one arm of a survey: check its recordings, calibrate, diagnose; results in memory.

The work may run in another process or on another machine, so it writes only temporary files.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.cli import verb
from pneunet_ros.cli.experiments import read_experiments
from pneunet_ros.cli.provenance import provenance_of, versions
from pneunet_ros.core.errors import ModelError
from pneunet_ros.diagnosis.diagnosis import investigate
from pneunet_ros.diagnosis.result import UnsettledDiagnosis
from pneunet_ros.diagnosis.settings import DEFAULTS
from pneunet_ros.discovery.discovery import discover
from pneunet_ros.effects.user_effects import add_effects
from pneunet_ros.exploration.proposal import with_proposal
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.files.json_text import json_text
from pneunet_ros.files.model_file import load_model, model_hash, save_model
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.messages.readings import SENSORS
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.calibration_files import described_arm, inputs_of, save_knowledge
from pneunet_ros.offline.check import check_recording
from pneunet_ros.offline.survey import Files, FleetArm
from pneunet_ros.offline.uses import UseRequest
from pneunet_ros.reports.diagnosis.files import MODEL, write_diagnosis
from pneunet_ros.reports.diagnosis.report import Given

CALIBRATED, FOUND = 'calibrated.yaml', 'found.json'
Runs = Sequence[RecordingData]


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyRequest:
    """Options for all arms: `--static`, `--topic`, the sensor settings, and the seed.

    effects_path: folder of user effects, read by every worker; '' for none.
    """

    static: bool
    topic: tuple[str, ...]
    sensors: dict[str, Any]
    seed: int
    effects_path: str = ''

    def arguments(self, unloaded: Sequence[Path]) -> Namespace:
        """Return the arguments for `calibrate` and `diagnose`."""
        return Namespace(
            static=self.static,
            topic=self.topic,
            unloaded=unloaded,
            end_load=[],
            string=[],
            earlier=None,
            **self.sensors,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyWork:
    """The work on one arm, picklable for running in another process."""

    request: SurveyRequest

    def __call__(self, arm: FleetArm) -> Files:
        """Return the output files of `calibrate` and `diagnose` for an arm, and a summary.

        Raises PneunetError if a recording, the calibration or the diagnosis fails.
        """
        if self.request.effects_path:
            add_effects(self.request.effects_path)
        frame = load_model(arm.arm)
        checks = self.check(arm, frame)
        with TemporaryDirectory() as path, verb.progress_bar(shown=False) as bar:
            arguments, of_heldout = (
                self.request.arguments(some) for some in (arm.roles['unloaded'], ())
            )
            read = read_experiments(
                (arm.roles['unloaded'], arm.roles['loaded']), frame, arguments, bar
            )
            kept = read_experiments((arm.roles['heldout'],), frame, of_heldout, bar)
            folder = Path(path) / 'arm'
            notes = [*(f'not used: {x}' for x in arm.ignored), *read.sentences, *kept.left_out]
            given = Given(
                notes=tuple(notes),
                model=f'DIR/{CALIBRATED}',
                recordings=tuple(map(str, arm.recordings)),
            )
            groups = (*read.groups, *kept.groups)
            found = self.calibrate_and_diagnose(arm, frame, groups, folder, given)
            found |= {'checks': checks, 'notes': [*notes, *found['notes']]}
            (folder / FOUND).write_text(json_text(found), encoding='utf-8')
            return {
                item.relative_to(folder).as_posix(): item.read_bytes()
                for item in sorted(folder.rglob('*'))
                if item.is_file()
            }

    def check(self, arm: FleetArm, frame: Arm) -> list[dict[str, Any]]:
        """Return a summary of `pneunet check` for each recording."""
        arguments = self.request.arguments(())
        request = UseRequest(
            arm=frame,
            settings=verb.settings_of(arguments),
            overrides=verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS]),
        )
        found = [check_recording(path, request) for path in arm.recordings]
        return [
            {
                'file': item['recording'].name,
                'seconds': item['seconds'],
                'uses': [name for name, use in item['uses'].items() if use['usable']],
                'sentences': item['sentences'],
            }
            for item in found
        ]

    def calibrate_and_diagnose(
        self, arm: FleetArm, frame: Arm, groups: tuple[Runs, ...], folder: Path, given: Given
    ) -> dict[str, Any]:
        """Write the files of both verbs to a new folder; return the summary for the survey."""
        unloaded, loaded, held_out = groups
        declared = verb.settings_of(self.request.arguments(())).judged_pressure
        calibration = calibrate(unloaded, loaded, frame, compare=False, declared=declared)
        if not calibration.joint.converged:
            raise ModelError(
                f'the calibration did not converge: {calibration.joint.status}',
                reason='not_settled',
            )
        arguments = Namespace(arm=arm.arm, earlier=None)
        roles = {'unloaded': unloaded, 'loaded': loaded}
        origin = provenance_of(arguments, calibration, roles)
        model = described_arm(calibration, arm.name, frame, origin)
        investigation = investigate(
            model,
            [*unloaded, *loaded],
            held_out,
            seed=self.request.seed,
            settings=replace(DEFAULTS, declared=declared),
        )
        discovery = discover(investigation)
        overruled = investigation.overruled(discovery.overruling)
        diagnosis = with_proposal(overruled, SafeSet.of(model)).diagnosis
        fitted = (*arm.roles['unloaded'], *arm.roles['loaded'])
        provenance = {
            'model': {'file': CALIBRATED, 'content_sha256': model_hash(model)},
            'inputs': inputs_of((('training', fitted), ('heldout', arm.roles['heldout']))),
            'versions': versions(),
        }
        used, tested = investigation.recordings  # minus the frames without an equilibrium
        content = write_diagnosis(
            diagnosis,
            folder,
            frame=model,
            training=used,
            held_out=tested,
            provenance=provenance,
            discovery=discovery,
            given=given,
        )
        save_model(model, folder / CALIBRATED)
        save_knowledge(calibration.posterior, folder / CALIBRATED, overwrite=False)
        entries = ('answer', 'sentence', 'effects', 'alternatives', 'gap', 'detectable')
        settled = not isinstance(diagnosis, UnsettledDiagnosis)
        return {
            **{name: content[name] for name in entries},
            'model': MODEL if settled else CALIBRATED,
            'loaded': bool(loaded),
            'target_std': calibration.noise.noise.target_std,
            'notes': [*calibration.notes, *content['notes']],
        }
