"""Configuration from the parameters of a gripper: its arms, and a block for each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import json
from typing import Any

from pneunet_ros import __version__
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.settings import check_settings, setting
from pneunet_ros.core.units import quantity
from pneunet_ros.fusion.grasp import Gripper, mount_of
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.link_chain import JOINT_STATES
from pneunet_ros.messages.markers import TIP_FRAME
from pneunet_ros.messages.readings import OF_ESTIMATOR as READ_BY_ESTIMATOR
from pneunet_ros.messages.readings import OF_FUSION as READ_BY_FUSION
from pneunet_ros.messages.tracker import TRACKER_INPUTS, TRACKER_OUTPUTS
from pneunet_ros.nodes.estimator.configuration import configured_estimator
from pneunet_ros.nodes.estimator.configuration import PARAMETERS as OF_ESTIMATOR
from pneunet_ros.nodes.fusion.configuration import configured_fusion
from pneunet_ros.nodes.fusion.configuration import PARAMETERS as OF_FUSION
from pneunet_ros.nodes.parameters import ParameterTable, SHIPPED_MODEL
from pneunet_ros.nodes.params_file import own_parameters
from pneunet_ros.nodes.tracker.configuration import configured_tracker
from pneunet_ros.nodes.tracker.configuration import PARAMETERS as OF_TRACKER
from pneunet_ros.vision.several_rows import check_rows
from pneunet_ros.vision.tracker import Tracker

TABLES = {'estimator': OF_ESTIMATOR, 'fusion': OF_FUSION, 'tracker': OF_TRACKER}
CONFIGURED: dict[str, Callable[[Mapping[str, Any], Any], Any]] = {
    'estimator': configured_estimator,
    'fusion': configured_fusion,
    'tracker': configured_tracker,
}
TOPICS, MOUNT = 'topics', 'mount'  # keys of a block
TOPICS_OF: dict[str, set[str]] = {
    'estimator': {
        *(one.topic for one in READ_BY_ESTIMATOR),
        *(one.name for one in (*OUTPUTS, JOINT_STATES)),
        *('markers', '/tf', 'model_info', '/diagnostics'),
    },
    'fusion': {
        *(one.topic for one in READ_BY_FUSION),
        *(one.name for one in FUSION_OUTPUTS),
        *('model_info', '/diagnostics'),
    },
    'tracker': {
        *(one.name for one in TRACKER_INPUTS),
        *(one.name for one in TRACKER_OUTPUTS),
        *('image_annotated', 'model_info', '/diagnostics'),
    },
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperSettings:
    """The arms, and their nodes in addition to the estimator."""

    arms: tuple[str, ...] = setting(
        ('left', 'right'), 'names of the arms: each has its own namespace, and may have a block'
    )
    fusion: bool = setting(True, 'whether every arm has a fusion')
    tracker: bool = setting(False, 'whether every arm has a tracker')
    model_file: str = setting(
        '', f'model file for arms without one in their block; empty: the shipped {SHIPPED_MODEL}'
    )
    frame_id: str = setting(BASE_FRAME, 'frame of the gripper')
    thickness: float = quantity(
        0.006,
        unit='m',
        meaning='distance from the centerline of an arm to its contact surface',
        bounds=(0.0, 1.0),
    )
    max_force: float = quantity(
        0.05, unit='N', meaning='largest force that is commanded from one arm', bounds=(0.0, 1e3)
    )
    width_tolerance: float = quantity(
        1e-3, unit='m', meaning='tolerance of a commanded width', bounds=(1e-6, 1.0)
    )
    closing_rate: float = quantity(
        20e3, unit='Pa/s', meaning='fastest change of a commanded pressure', bounds=(1.0, 1e9)
    )
    closing_gain: float = quantity(
        3.0,
        unit='1/s',
        meaning='share of the remaining error that is corrected per second; reduce it for a slow '
        'valve',
        bounds=(1e-3, 1e3),
    )
    hold_after: float = quantity(
        0.3,
        unit='s',
        meaning='time without frames after which the last command is held, and largest '
        'difference between the stamps of the frames of a grasp',
        bounds=(1e-3, 1e3),
    )

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)
        wrong = [name for name in self.arms if not name.isidentifier() or name in TABLES]
        if wrong or len(set(self.arms)) < len(self.arms) or not self.arms:
            raise RequestError(
                'arms must be different names made of letters, digits and _, not '
                f'{list(self.arms)}',
                reason='wrong_name',
            )

    @property
    def nodes(self) -> tuple[str, ...]:
        """The nodes of every arm, in order of priority."""
        optional = {'fusion': self.fusion, 'tracker': self.tracker}
        return ('estimator', *(name for name, enabled in optional.items() if enabled))


PARAMETERS = ParameterTable(
    owners=(GripperSettings,),
    read_only=frozenset({'arms', 'fusion', 'tracker', 'model_file', 'frame_id', 'thickness'}),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperConfiguration:
    """The settings of a gripper."""

    node: GripperSettings

    @property
    def model(self) -> str:
        """Return the name of the gripper: its arms."""
        return f'gripper of {", ".join(self.node.arms)}'

    def info(self) -> str:
        """Return the content of the topic gripper_info."""
        return json.dumps(
            {'arms': self.node.arms, 'nodes': self.node.nodes, 'version': __version__}
        )


def configured_gripper(
    values: Mapping[str, Any], current: GripperConfiguration | None
) -> GripperConfiguration:
    """Return the configuration for all parameter values; RequestError for invalid ones."""
    (node,) = PARAMETERS.settings(values)
    return GripperConfiguration(node=node)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmBlock:
    """The block of one arm: topics by name, parameters by node, and its mount if any."""

    topics: Mapping[str, str]
    mount: Sequence[float] | None
    parameters: Mapping[str, Mapping[str, Any]]


def parameters_of(settings: GripperSettings, block: ArmBlock, node: str) -> dict[str, Any]:
    """Return the given parameters of a node of an arm, from its block or for all arms."""
    given: dict[str, Any] = {'model_file': settings.model_file} if settings.model_file else {}
    if node == 'estimator' and settings.fusion:
        given['watch_targets'] = False  # the fusion compares targets already
    return given | dict(block.parameters[node])


def check_own(files: Iterable[str], node: str, given: Mapping[str, Any]) -> None:
    """Raise RequestError if a file and the gripper give a node of an arm different values.

    node: full name; given: its parameters from the gripper, which would win.
    """
    for path in files:
        own = own_parameters(path, node)
        twice = [name for name in given.keys() & own.keys() if given[name] != own[name]]
        if twice:
            raise RequestError(
                f'{path} gives {node} its own {min(twice)}, and the gripper gives it another: put '
                'it into the block of this arm',
                reason='given_twice',
            )


def check_blocks(given: Mapping[str, Any]) -> None:
    """Raise PneunetError if a node of an arm would reject its parameters or files.

    given: parameters of the gripper as in a file, with blocks as mappings.
    """
    values = PARAMETERS.completed(given)
    settings = configured_gripper(values, None).node
    blocks, _ = arms_of(settings, dict(flatten_blocks(given)))
    trackers: dict[str, dict[str, Tracker]] = {}
    for arm, block in blocks.items():
        for node in settings.nodes:
            completed = TABLES[node].completed(parameters_of(settings, block, node))
            configuration = CONFIGURED[node](completed, None)
            topic = block.topics.get('image_raw', '')
            if node == 'tracker' and topic.startswith('/'):
                trackers.setdefault(topic, {})[arm] = configuration.tracker
    for of_camera in trackers.values():
        check_rows(of_camera)


def arms_of(
    settings: GripperSettings, given: Mapping[str, Any]
) -> tuple[dict[str, ArmBlock], Gripper | None]:
    """Return the blocks of all arms, and the gripper if they have mounts.

    given: as for `block_of`. RequestError for unknown keys, invalid mounts, and arms that would
    share a frame.
    """
    blocks = {arm: block_of(arm, given) for arm in settings.arms}
    topics = {topic for of_node in TOPICS_OF.values() for topic in of_node}
    for arm, block in blocks.items():
        for name in block.topics.keys() - topics:
            raise RequestError(
                f'{arm}.{TOPICS}.{name}: the nodes of an arm have no topic {name}; theirs are '
                f'{", ".join(sorted(topics))}',
                reason='unknown_key',
            )
    of_estimator = [block.parameters['estimator'] for block in blocks.values()]
    tips = [one.get('tip_frame', TIP_FRAME) for one in of_estimator if one.get('publish_tf')]
    if len(set(tips)) < len(tips):
        raise RequestError(
            f'arms with publish_tf need different values of tip_frame, not {", ".join(tips)}',
            reason='given_twice',
        )
    return blocks, gripper_of(settings, blocks)


def gripper_of(settings: GripperSettings, blocks: Mapping[str, ArmBlock]) -> Gripper | None:
    """Return the gripper with its mounts; None without mounts or without a fusion.

    RequestError if only some blocks have a mount, or if the mounts or frames are invalid.
    """
    without = [arm for arm, block in blocks.items() if block.mount is None]
    if len(without) == len(blocks) or not settings.fusion:
        return None
    if without:
        raise RequestError(
            f'{MOUNT} is missing from the block of {", ".join(without)}', reason='missing'
        )
    frames = {
        arm: {str(block.parameters[node].get('frame_id', BASE_FRAME)) for node in settings.nodes}
        for arm, block in blocks.items()
    }
    every = [settings.frame_id, *(frame for of_arm in frames.values() for frame in of_arm)]
    if len(set(every)) < len(every) or len(every) > 1 + len(frames):
        listed = '; '.join(f'{arm}: {", ".join(sorted(of_arm))}' for arm, of_arm in frames.items())
        raise RequestError(
            f'each arm with a {MOUNT} needs a frame_id of its own in its block, the same for all '
            f'its nodes and not that of the gripper ({settings.frame_id}): {listed}',
            reason='given_twice',
        )
    return Gripper(
        mounts={
            arm: mount_of(block.mount, settings.thickness)
            for arm, block in blocks.items()
            if block.mount is not None
        }
    )


def flatten_blocks(given: Mapping[str, Any], above: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings with their keys joined by dots."""
    for key, value in given.items():
        if isinstance(value, Mapping):
            yield from flatten_blocks(value, f'{above}{key}.')
        else:
            yield f'{above}{key}', value


def block_of(arm: str, given: Mapping[str, Any]) -> ArmBlock:
    """Return the block of an arm.

    given: parameters of the gripper, those of a block as NAME.KEY. A key is one of: `topics.` and
    the name of a topic; a node and one of its parameters (`fusion.use_wrench`); a parameter for
    all nodes that have it; `mount`. RequestError for any other key.
    """
    topics: dict[str, str] = {}
    mount: Sequence[float] | None = None
    shared: dict[str, Any] = {}
    by_node: dict[str, dict[str, Any]] = {node: {} for node in TABLES}
    for name, value in given.items():
        owner, _, key = name.partition('.')
        if owner != arm:
            continue
        first, _, rest = key.partition('.')
        if first == TOPICS and rest:
            topics[topic_of(rest)] = str(value)
        elif key == MOUNT:
            mount = value
        elif first in TABLES and rest in names_of(first):
            by_node[first][rest] = value
        elif any(key in names_of(node) for node in TABLES):
            shared[key] = value
        else:
            raise RequestError(
                f'{name} is not a parameter of {", ".join(TABLES)}. A block has their '
                f'parameters, {TOPICS} (topic names) and {MOUNT}',
                reason='unknown_key',
            )
    return ArmBlock(
        topics=topics,
        mount=mount,
        parameters={
            node: {key: value for key, value in shared.items() if key in names_of(node)} | values
            for node, values in by_node.items()
        },
    )


def is_used(settings: GripperSettings, key: str) -> bool:
    """Whether a valid key of a block has an effect on the nodes that every arm has."""
    first, nodes = key.partition('.')[0], settings.nodes
    if first in TABLES:
        return first in nodes
    if key == MOUNT:
        return settings.fusion
    if first == TOPICS:
        topic = topic_of(key.partition('.')[2])
        return any(topic in TOPICS_OF[node] for node in nodes)
    return any(key in names_of(node) for node in nodes)


def topic_of(key: str) -> str:
    """Return the name of the topic of a key of `topics` in a block."""
    return key.replace('.', '/')


def names_of(node: str) -> set[str]:
    """Return the names of the parameters of a node of an arm."""
    return {item.name for item in TABLES[node].fields}
