"""The parameters of the estimator: one table, made of the fields of two dataclasses of settings.

Names, defaults, units, bounds and meanings stand in the fields and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneunet_ros.errors import RequestError
from pneunet_ros.resources import shipped
from pneunet_ros.settings import EstimatorSettings, setting
from pneunet_ros.units import check_quantities, quantity
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException

SHIPPED_MODEL = 'config/paper_arm.yaml'

# Topics and the layout of messages hang on these: they hold for the life of a node.
READ_ONLY = frozenset({'frame_id', 'stations', 'wrench_required'})

_KINDS = {
    bool: 'true or false',
    int: 'an integer',
    float: 'a number with a decimal point (1.0, not 1)',
    str: 'a text',
}


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """What the node must know beside the settings of the estimator."""

    model_file: str = setting('', f'model file of the arm; empty: the shipped {SHIPPED_MODEL}')
    centerline_rate: float = quantity(
        30.0,
        unit='Hz',
        meaning='largest rate of the topic centerline; 0: every estimate',
        bounds=(0.0, 1000.0),
    )

    def __post_init__(self) -> None:
        """Refuse values outside their declaration."""
        check_quantities(self, '', RequestError)

    @property
    def model_path(self) -> Path:
        """Where the model file is."""
        return Path(self.model_file) if self.model_file else shipped(SHIPPED_MODEL)


PARAMETERS: tuple[dataclasses.Field[Any], ...] = (
    *dataclasses.fields(NodeSettings),
    *dataclasses.fields(EstimatorSettings),
)
NAMES = frozenset(field.name for field in PARAMETERS)


def describe(field: dataclasses.Field[Any]) -> ParameterDescriptor:
    """Describe a parameter for people, and for rclpy, which holds it to its range."""
    meta = field.metadata
    unit = meta.get('unit')
    descriptor = ParameterDescriptor(
        name=field.name,
        description=meta['meaning'] + (f' ({unit})' if unit else ''),
        read_only=field.name in READ_ONLY,
    )
    if 'bounds' in meta:
        low, high = meta['bounds']
        if isinstance(field.default, float):
            span = FloatingPointRange(from_value=low, to_value=high)
            descriptor.floating_point_range = [span]
        else:
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
    if meta.get('choices'):
        choices = ', '.join(str(choice) for choice in meta['choices'])
        descriptor.additional_constraints = f'one of {choices}'
    return descriptor


def declare(node: Any) -> dict[str, Any]:
    """Declare all parameters; returns their values. RequestError names one that is unfit."""
    # What rclpy would say of an unfit value is a traceback, and then without the bounds.
    given = {name: parameter.value for name, parameter in overrides(node).items()}
    for field in PARAMETERS:
        value = given.setdefault(field.name, field.default)
        if type(value) is not type(field.default):
            kind = _KINDS[type(field.default)]
            raise RequestError(f'parameter {field.name} must be {kind}, not {value!r}')
    settings_from(given)
    try:
        for field in PARAMETERS:
            node.declare_parameter(field.name, field.default, describe(field))
    except ParameterException as error:
        raise RequestError(f'{error}') from error
    return values(node)


def overrides(node: Any) -> Mapping[str, Any]:
    """Return the parameters that were given to a node from outside; rclpy has no public way."""
    given: Mapping[str, Any] = getattr(node, '_parameter_overrides', {})
    return given


def values(node: Any) -> dict[str, Any]:
    """Return the values of all parameters by name."""
    return {field.name: node.get_parameter(field.name).value for field in PARAMETERS}


def settings_from(given: Mapping[str, Any]) -> tuple[NodeSettings, EstimatorSettings]:
    """Build the settings from the values of all parameters; RequestError for one out of bounds."""
    return (
        NodeSettings(**_of(NodeSettings, given)),
        EstimatorSettings(**_of(EstimatorSettings, given)),
    )


def without_effect(node: Any) -> list[str]:
    """Return the names given to a node that has all its parameters, and that are none of them."""
    return sorted(name for name in overrides(node) if not node.has_parameter(name))


def _of(owner: type, given: Mapping[str, Any]) -> dict[str, Any]:
    return {field.name: given[field.name] for field in dataclasses.fields(owner)}
