"""Archives of arrays (npz), damaged in any way: knowledge of a calibration, truth of the lab."""

from __future__ import annotations

import io
import json
from pathlib import Path
import pickle
from typing import Any
import zipfile

from hypothesis import strategies as st
import numpy as np
from pneunet_ros.calibration.parameters import PosteriorState
from pneunet_ros.core.errors import ModelError, RequestError
from pneunet_ros.files.npz import LARGEST_ARCHIVE
from pneunet_ros.lab.lab_recording import LabMemory
from pneunet_ros.offline.calibration_files import knowledge_file, load_knowledge, save_knowledge
from pneunet_ros.recordings.lab_files import memory_after, truth_file
import pytest
from support.fuzzing import AMOUNTS, answer, damaged_bytes, fuzz

KNOWLEDGE = {
    'pressure': np.array([0.0, 3e4, 6e4]),
    'arclength': np.array([0.0, 0.5, 1.0]),
    'kind': np.array('piecewise_linear'),
    'stiffness': np.array(2e-4),
    'low': np.array(0.0),
    'high': np.array(6e4),
    'values': np.arange(2.0),
    'information': np.eye(2),
    'placement': np.arange(2.0),
    'covariance': np.eye(4),
}
MEMORY = {'time': 3.0, 'pressure': 2e4, 'past': {'creep': [1.0, 2.0], 'hysteresis': [3.0]}}
TRUTH = {'stamp_ns': np.arange(3), 'memory': np.array(json.dumps(MEMORY))}


def posterior(folder: Path) -> tuple[Path, Any, Any]:
    model = folder / 'arm.yaml'
    return knowledge_file(model), lambda: load_knowledge(model), (PosteriorState, ModelError)


def truth(folder: Path) -> tuple[Path, Any, Any]:
    recording = folder / 'lab.mcap'
    return truth_file(recording), lambda: memory_after(recording), (LabMemory, RequestError)


KINDS = {'knowledge': (posterior, KNOWLEDGE), 'truth': (truth, TRUTH)}
ARRAYS = st.sampled_from(
    [
        np.array('piecewise_linear'), np.array('x' * 1000), np.array(b'x'), np.array(1.0),
        np.array(np.nan), np.array([]), np.eye(3), np.zeros((4, 4)), np.full((4, 4), np.inf),
        np.arange(4), np.arange(4) * 1j, np.array(['a', 'b']), np.array(True), -np.eye(4),
        np.array(json.dumps({'time': 'x', 'pressure': [], 'past': {'a': 3}})),
        np.array(json.dumps({'time': 1e400, 'pressure': None, 'past': []})),
        np.array('{"time": 1, "pressure": 2, "past": {"creep": ["a", {}]}}'),
        np.array('[' * 20_000), np.array('"\\ud800"'), np.array(f'{{"time": {"9" * 5000}}}'),
        np.zeros(3, [('a', 'f8')]), np.array(['2001-01-01'], 'M8[D]'),
        np.float32(2.0) * np.ones(4),
    ]
)  # fmt: skip


@AMOUNTS
@pytest.mark.parametrize('kind', KINDS)
def test_any_bytes_are_read_or_refused(tmp_path, kind, examples):
    of_kind, whole = KINDS[kind]
    path, load, outcomes = of_kind(tmp_path)
    np.savez(path, **whole)
    plain = path.read_bytes()
    np.savez_compressed(path, **whole)
    assert isinstance(answer(load), outcomes[0])

    def body(raw: bytes) -> None:
        path.write_bytes(raw)
        assert isinstance(answer(load), outcomes)

    fuzz(4 * examples, body, raw=damaged_bytes(plain) | damaged_bytes(path.read_bytes()))


@AMOUNTS
@pytest.mark.parametrize('kind', KINDS)
def test_any_arrays_are_read_or_refused(tmp_path, kind, examples):
    of_kind, whole = KINDS[kind]
    path, load, outcomes = of_kind(tmp_path)

    def body(changes: dict[str, Any], left_out: str | None) -> None:
        np.savez(
            path, **{key: value for key, value in (whole | changes).items() if key != left_out}
        )
        found = answer(load)
        assert isinstance(found, outcomes)
        if isinstance(found, PosteriorState):
            assert np.isfinite(found.values).all()
            assert np.isfinite(found.covariance).all()
            assert np.isfinite([found.stiffness, found.low, found.high]).all()
        if isinstance(found, LabMemory):
            numbers = [
                found.time,
                found.pressure,
                *(x for past in found.past.values() for x in past),
            ]
            assert np.isfinite(numbers).all()

    changes = st.dictionaries(st.sampled_from(sorted(whole)), ARRAYS, max_size=3)
    fuzz(examples, body, changes=changes, left_out=st.none() | st.sampled_from(sorted(whole)))


def header(shape: tuple[int, ...], kind: str = '<f8') -> bytes:
    """Make an array file whose header promises more than there is."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {'descr': kind, 'fortran_order': False, 'shape': shape}
    )
    return stream.getvalue()


class Touching:
    """What executes when it is unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path('was_here'),)


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize(
    'what', ['pickle', 'bomb', 'promise', 'path', 'empty', 'no archive', 'object']
)
def test_no_archive_executes_or_blows_up(tmp_path, monkeypatch, kind, what):
    monkeypatch.chdir(tmp_path)
    of_kind, whole = KINDS[kind]
    path, load, outcomes = of_kind(tmp_path)
    first = 'values' if kind == 'knowledge' else 'memory'
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name, value in whole.items():
            stream = io.BytesIO()
            np.save(stream, value)
            content = stream.getvalue()
            if name == first and what == 'bomb':
                content = header((40_000_000,)) + bytes(320_000_000)
            if name == first and what == 'promise':
                content = header((2**44,))
            if name == first and what == 'object':
                content = header((1,), '|O') + pickle.dumps(Touching())
            if what != 'empty':
                archive.writestr(f'../{name}.npy' if what == 'path' else f'{name}.npy', content)
    if what == 'pickle':
        path.write_bytes(pickle.dumps(Touching()))
    elif what == 'no archive':
        np.save(path.with_suffix('.npy'), np.zeros(3))
        path.write_bytes(path.with_suffix('.npy').read_bytes())
    found = answer(load)
    assert isinstance(found, outcomes[1])
    assert str(path) in str(found)
    if what == 'bomb':
        assert f'{LARGEST_ARCHIVE // 1_000_000} MB' in str(found)
    assert not (tmp_path / 'was_here').exists()


def test_what_is_written_is_read_again(tmp_path):
    values = {name: array if array.ndim else array.item() for name, array in KNOWLEDGE.items()}
    save_knowledge(PosteriorState(**values), tmp_path / 'arm.yaml', overwrite=False)
    found = load_knowledge(tmp_path / 'arm.yaml')
    assert np.array_equal(found.covariance, np.eye(4))
    assert found.kind == 'piecewise_linear'
