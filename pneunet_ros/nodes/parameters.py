"""The parameters of a node: one table from the fields of settings dataclasses.

Names, defaults, units, bounds and meanings are defined only in the fields.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.user_effects import add_effects
from pneunet_ros.estimation.base_gravity import GravitySource
from pneunet_ros.files.model_file import load_model
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.gravity import gravity_of
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException

SHIPPED_MODEL = 'config/paper_arm.yaml'

_KINDS = {
    bool: 'true or false',
    int: 'an integer',
    float: 'a number with a decimal point (1.0, not 1)',
    str: 'a text',
    tuple: 'a list of texts',
}
VECTORS = ('gravity', 'imu_from_base')  # texts of numbers, which may also be a list of numbers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterTable:
    """The fields of settings dataclasses as the parameters of a node.

    read_only: names of parameters fixed for the lifetime of a node, because topics and message
    layouts depend on them. left_out: fields that the node does not use, which keep their default.
    """

    owners: tuple[type, ...]
    read_only: frozenset[str]
    left_out: frozenset[str] = frozenset()
    fields: tuple[dataclasses.Field[Any], ...] = field(init=False)

    def __post_init__(self) -> None:
        """Collect the fields."""
        fields = tuple(item for owner in self.owners for item in self.used_fields(owner))
        object.__setattr__(self, 'fields', fields)

    def used_fields(self, owner: type) -> list[dataclasses.Field[Any]]:
        """Return the fields of a settings dataclass that are parameters of the node."""
        fields = dataclasses.fields(owner)
        return [item for item in fields if item.name not in self.left_out]

    def describe(self, item: dataclasses.Field[Any]) -> ParameterDescriptor:
        """Describe a parameter for users, and for rclpy, which enforces its range."""
        meta = item.metadata
        unit = meta.get('unit')
        descriptor = ParameterDescriptor(
            name=item.name,
            description=meta['meaning'] + (f' ({unit})' if unit not in (None, '-') else ''),
            read_only=item.name in self.read_only,
            dynamic_typing=item.name in VECTORS,
        )
        if 'bounds' in meta:
            low, high = meta['bounds']
            if isinstance(item.default, float):
                span = FloatingPointRange(from_value=low, to_value=high)
                descriptor.floating_point_range = [span]
            else:
                descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        if meta.get('choices'):
            choices = ', '.join(str(choice) for choice in meta['choices'])
            descriptor.additional_constraints = f'one of {choices}'
        return descriptor

    def declare(self, node: Any) -> dict[str, Any]:
        """Declare all parameters; returns their values. RequestError names an invalid one."""
        # Checked before rclpy, which would print a traceback that does not state the bounds.
        given = {name: parameter.value for name, parameter in overrides(node).items()}
        self.settings(self.completed(given))
        try:
            for item in self.fields:
                node.declare_parameter(item.name, item.default, self.describe(item))
        except ParameterException as error:
            raise RequestError(f'{error}', reason='wrong_value') from error
        return self.values(node)

    def completed(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all parameters; RequestError names one with a wrong type."""
        values = {
            item.name: setting_value(item.name, given.get(item.name, item.default))
            for item in self.fields
        }
        for item in self.fields:
            if type(values[item.name]) is not type(item.default):
                kind, value = _KINDS[type(item.default)], values[item.name]
                bare = isinstance(item.default, str) and isinstance(value, bool)
                hint = (
                    (' (YAML reads N, y or no without quotes as true or false: put it in quotes)')
                    if bare
                    else ''
                )
                raise RequestError(
                    f'parameter {item.name} must be {kind}, not {value!r}{hint}',
                    reason='wrong_type',
                )
        return values

    def values(self, node: Any) -> dict[str, Any]:
        """Return the values of all parameters by name."""
        return {
            item.name: setting_value(item.name, node.get_parameter(item.name).value)
            for item in self.fields
        }

    def settings(self, given: Mapping[str, Any]) -> tuple[Any, ...]:
        """Build one settings object per owner; RequestError for a value out of bounds.

        given: the values of all parameters by name; other names are ignored.
        """
        return tuple(
            owner(**{item.name: given[item.name] for item in self.used_fields(owner)})
            for owner in self.owners
        )


def setting_value(name: str, value: Any) -> Any:
    """Return a parameter value in the form used by the settings.

    A list of numbers in `VECTORS` becomes a text, any other list a tuple.
    """
    if name in VECTORS and isinstance(value, list | array):
        numbers = not any(isinstance(one, str) for one in value)
        value = ', '.join(map(repr, value)) if numbers else value
    return tuple(value) if isinstance(value, list) else value


def overrides(node: Any) -> Mapping[str, Any]:
    """Return the parameter overrides of a node, for which rclpy has no public function."""
    given: Mapping[str, Any] = getattr(node, '_parameter_overrides', {})
    return given


def undeclared_overrides(node: Any) -> list[str]:
    """Return the given names that are not parameters of a node; all must have been declared."""
    return sorted(name for name in overrides(node) if not node.has_parameter(name))


EFFECTS_PATH = (
    'folder with your own effect files (*.py), which are executed; empty: only the effects of '
    'the library and of installed packages'
)


GRAVITY = (
    'direction of gravity: out_of_plane; x and y of the unit vector that points down, in the '
    'base frame, e.g. "0, -1"; or imu, from base_imu only; empty: from base_imu if it is '
    'published, else as in the model file'
)


def arm_from_file(model_file: str, effects_path: str, gravity: str = '') -> Arm:
    """Return the arm of a model file, with effects of the library and of a user's folder."""
    if effects_path:
        add_effects(effects_path)
    arm = load_model(model_path(model_file))
    return (
        arm if not gravity else dataclasses.replace(arm, gravity=gravity_of(gravity, fixed=True))
    )


def check_source(new: GravitySource, old: GravitySource) -> None:
    """Reject a source of gravity whose topics the node does not read; old: source at startup."""
    if new.frame != old.frame or new.uses_imu > old.uses_imu:
        raise RequestError(
            'this node was started without the topics that give the direction of gravity '
            f'({new.frame or "base_imu"}): restart it with that model or parameter',
            reason='no_gravity',
        )


def model_path(model_file: str) -> Path:
    """Return the path of the model file named by the parameter `model_file`."""
    return Path(model_file) if model_file else share_path(SHIPPED_MODEL)
