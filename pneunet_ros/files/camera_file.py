"""Camera files: camera.yaml -> `CameraSettings`, the YAML of camera_calibration -> `Lens`."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from pneunet_ros.core.arrays import Array, table_array
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.units import quantities
from pneunet_ros.files.yaml_file import or_default, YamlFile
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import (
    AdaptiveBand,
    AreaLimits,
    CameraSettings,
    CurvedRestPlane,
    FixedBand,
    GreyBand,
    HomographyPlane,
    PlaneMethod,
    PosePlane,
    RestPlane,
    Shutter,
)

SCHEMA_VERSION = 1
CAMERA_FILE = YamlFile(kind='camera file', error=CameraError)
CALIBRATION_FILE = YamlFile(kind='camera_info file', error=CameraError)
PLANES = {
    plane.method: plane for plane in (RestPlane, CurvedRestPlane, HomographyPlane, PosePlane)
}
BANDS = {band.method: band for band in (AdaptiveBand, FixedBand)}
CALIBRATION = (
    'image_width',
    'image_height',
    'camera_matrix',
    'distortion_model',
    'distortion_coefficients',
)


def load_camera(path: str | Path) -> CameraSettings:
    """Read a camera file; CameraError names the file, the key and the allowed values.

    Missing keys have the defaults of the shipped config/camera.yaml.
    """
    return CAMERA_FILE.load(path, settings_from_mapping)


def load_camera_info(path: str | Path) -> Lens:
    """Read the camera_info YAML written by camera_calibration; raises CameraError."""
    return CALIBRATION_FILE.load(path, lens_from_mapping)


def settings_from_mapping(content: Any) -> CameraSettings:
    """Build the settings from the content of a camera file."""
    names = tuple(field.name for field in fields(CameraSettings))
    top = CAMERA_FILE.block(content, '', ('schema_version', *names), set(names))
    CAMERA_FILE.check_version(top.pop('schema_version'), SCHEMA_VERSION)
    scalar = {item.name for item in quantities(CameraSettings)}
    values: dict[str, Any] = {
        key: CAMERA_FILE.number(value, key) if key in scalar else value
        for key, value in top.items()
    }
    for key, build in (
        ('plane', plane_from_mapping),
        ('grey_band', band_from_mapping),
        ('area', area_from_mapping),
        ('shutter', shutter_from_mapping),
    ):
        if values.get(key) is None:
            values.pop(key, None)
        else:
            values[key] = build(values[key])
    return CameraSettings(**values)


def plane_from_mapping(content: Any) -> PlaneMethod:
    """Build the settings of the working plane for its `method`."""
    plane = PLANES[method_of(content, 'plane', tuple(PLANES))]
    names = tuple(field.name for field in fields(plane))
    values = CAMERA_FILE.block(content, 'plane', ('method', *names))
    del values['method']
    built: PlaneMethod = plane(**values)
    return built


def band_from_mapping(content: Any) -> GreyBand:
    """Build the band of grey levels for its `method`."""
    band = BANDS[method_of(content, 'grey_band', tuple(BANDS))]
    built: GreyBand = band(**CAMERA_FILE.numbers_of(band, content, 'grey_band', ('method',)))
    return built


def area_from_mapping(content: Any) -> AreaLimits:
    """Build the limits of areas."""
    return AreaLimits(**CAMERA_FILE.numbers_of(AreaLimits, content, 'area'))


def shutter_from_mapping(content: Any) -> Shutter:
    """Build the times of the shutter."""
    return Shutter(**CAMERA_FILE.numbers_of(Shutter, content, 'shutter'))


def method_of(content: Any, where: str, known: tuple[str, ...]) -> str:
    """Return the method named in a block, which must be a known one."""
    method = CAMERA_FILE.mapping(content, where).get('method')
    if not isinstance(method, str) or method not in known:
        raise CameraError(
            f'{where}.method must be one of {", ".join(known)}, not {method!r}',
            reason='unknown_kind',
        )
    return method


def lens_from_mapping(content: Any) -> Lens:
    """Build the lens from the content of a camera_info file."""
    top = CALIBRATION_FILE.mapping(content, '')
    needed = {key: value for key, value in top.items() if key in CALIBRATION}
    values = CALIBRATION_FILE.block(needed, '', CALIBRATION)
    matrix = data_of(values['camera_matrix'], 'camera_matrix')
    if matrix.size != 9:
        raise CameraError(
            f'camera_matrix.data must be 9 numbers, not {matrix.size}', reason='wrong_shape'
        )
    return Lens(
        width=values['image_width'],
        height=values['image_height'],
        model=or_default(values['distortion_model'], ''),
        matrix=matrix.reshape(3, 3),
        distortion=data_of(values['distortion_coefficients'], 'distortion_coefficients'),
    )


def data_of(content: Any, where: str) -> Array:
    """Return the entries (`data`) of a matrix, row by row."""
    data = CALIBRATION_FILE.mapping(content, where).get('data')
    return table_array(or_default(data, []), f'{where}.data', 1, CameraError)
