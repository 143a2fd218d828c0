"""Safe reading of hand-written YAML files; each error is one sentence that names its location."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, MISSING
from functools import lru_cache
from itertools import accumulate
import math
from pathlib import Path
from typing import Any, TypeVar

from pneunet_ros.core.errors import PneunetError, read_failure
from pneunet_ros.core.units import quantities
from pneunet_ros.files.regular_file import open_regular
from ruamel.yaml import YAML
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.error import YAMLError

LARGEST_FILE = 1_000_000  # bytes
LARGEST_CONTENT = 1_000_000  # values, counted as often as aliases repeat them
DEEPEST = 100  # nested brackets
LARGEST_INTEGER = 10**1000  # Python refuses to convert much longer integers to text
LONGEST_SENTENCE = 600  # characters

Built = TypeVar('Built')


class PlainConstructor(SafeConstructor):
    """YAML constructor for plain values, without merge keys, which could grow without bound."""

    def flatten_mapping(self, node: Any) -> None:
        """Reject merge keys."""
        for key, _ in node.value:
            if key.tag == 'tag:yaml.org,2002:merge':
                raise ConstructorError(
                    problem='merge keys (<<) are not supported: write out the values',
                    problem_mark=key.start_mark,
                )
        super().flatten_mapping(node)

    def construct_yaml_int(self, node: Any) -> int:
        """Reject integers that are too long to be shown in a message."""
        number: int = super().construct_yaml_int(node)
        if abs(number) > LARGEST_INTEGER:
            raise ConstructorError(
                problem='an integer of more than 1000 digits', problem_mark=node.start_mark
            )
        return number

    def construct_yaml_str(self, node: Any) -> str:
        """Reject escapes that are invalid in text: NUL and lone surrogates."""
        text: str = super().construct_yaml_str(node)
        if any(character == '\0' or '\ud800' <= character <= '\udfff' for character in text):
            raise ConstructorError(
                problem='a text with a null character or a lone surrogate',
                problem_mark=node.start_mark,
            )
        return text


for tag, construct in (
    ('int', PlainConstructor.construct_yaml_int),
    ('str', PlainConstructor.construct_yaml_str),
):
    PlainConstructor.add_constructor(f'tag:yaml.org,2002:{tag}', construct)


@lru_cache(maxsize=8)  # every node of a gripper and every arm of a fleet reads the same model
def parsed(text: str) -> Any:
    """Return the content of a text; callers must not change it."""
    yaml = YAML(typ='safe', pure=True)
    yaml.Constructor = PlainConstructor
    yaml.composer.warn_double_anchors = False  # YAML allows this; the last value counts
    return yaml.load(text)


@dataclass(frozen=True, slots=True, kw_only=True)
class YamlFile:
    """A kind of file: its name in messages, the error to raise, and its numbers."""

    kind: str
    error: type[PneunetError]
    number_name: str = 'a number'

    def load(self, path: str | Path, build: Callable[[Any], Built]) -> Built:
        """Build an object from the content of a file; errors name the file and the key."""
        path = Path(path)
        try:
            with open_regular(path) as stream:
                data = stream.read(LARGEST_FILE + 1)
            if len(data) > LARGEST_FILE:
                raise self.error(
                    f'{path} is larger than {LARGEST_FILE // 1_000_000} MB, so it is not a '
                    f'{self.kind}',
                    reason='too_large',
                )
            text = data.decode('utf-8')
        except (OSError, ValueError) as error:
            why = getattr(error, 'strerror', None) or error
            raise self.error(
                f'cannot read the {self.kind} {path}: {why}', reason=read_failure(error)
            ) from None
        if depth_of(text) > DEEPEST:
            raise self.error(
                f'{path} is not valid YAML: more than {DEEPEST} brackets are open',
                reason='not_yaml',
            )
        try:
            content = deepcopy(parsed(text))
        except (YAMLError, ValueError, LookupError, TypeError, RecursionError) as error:
            raise self.error(
                f'{path} is not valid YAML: {one_line(error)}', reason='not_yaml'
            ) from None
        try:
            if size_of(content, {}) > LARGEST_CONTENT:
                raise self.error(
                    f'its aliases expand to more than {LARGEST_CONTENT:,} values',
                    reason='too_large',
                )
            return build(content)
        except self.error as error:
            raise self.error(f'{path}: {one_line(error)}', reason=error.reason) from None

    def mapping(self, content: Any, where: str) -> dict[str, Any]:
        """Return a mapping with text keys, or raise the error."""
        if not isinstance(content, Mapping) or not all(isinstance(key, str) for key in content):
            raise self.error(
                f'{where or "the file"} must be a mapping of names to values',
                reason='not_a_mapping',
            )
        return dict(content)

    def block(
        self, content: Any, where: str, known: tuple[str, ...], optional: set[str] | None = None
    ) -> dict[str, Any]:
        """Return a mapping that has no unknown keys and no missing ones, except optional ones."""
        values = self.mapping(content, where)
        prefix = f'{where}.' if where else ''
        for key in values:
            if key not in known:
                raise self.error(
                    f'unknown key {prefix}{key}; known keys: {", ".join(known)}',
                    reason='unknown_key',
                )
        missing = [key for key in known if key not in values and key not in (optional or set())]
        if missing:
            raise self.error(
                f'{prefix}{missing[0]} is missing; the keys are {", ".join(known)}',
                reason='missing_key',
            )
        return values

    def check_version(self, given: Any, known: int) -> None:
        """Reject a file written for another version of its format."""
        if isinstance(given, bool) or given != known:
            raise self.error(
                f'schema_version {given!r} is not supported, only {known}',
                reason='unknown_version',
            )

    def numbers_of(
        self, owner: type, content: Any, where: str, other_keys: tuple[str, ...] = ()
    ) -> dict[str, float]:
        """Return the fields of a dataclass from a mapping; fields with a default are optional.

        other_keys: further keys that the mapping may have; they are ignored.
        """
        declared = quantities(owner)
        optional = {item.name for item in declared if item.default is not MISSING}
        names = (*other_keys, *(item.name for item in declared))
        values = self.block(content, where, names, {*optional, *other_keys})
        return {
            key: self.number(value, f'{where}.{key}')
            for key, value in values.items()
            if key not in other_keys
        }

    def number(self, value: Any, where: str) -> float:
        """Return a number from the file."""
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
            raise self.error(
                f'{where} must be {self.number_name}, not {value!r}', reason='not_a_number'
            )
        try:
            return float(value)
        except OverflowError:
            raise self.error(
                f'{where} is too large to be {self.number_name}', reason='too_large'
            ) from None


def one_line(error: Exception) -> str:
    """Return the text of an error, in one line of bounded length."""
    words = ' '.join(str(error).split())
    return words if len(words) <= LONGEST_SENTENCE else f'{words[:LONGEST_SENTENCE]} ...'


def depth_of(text: str) -> int:
    """Return the nesting depth of brackets; deep nesting stalls the parser."""
    steps = ((mark in '[{') - (mark in ']}') for mark in text if mark in '[]{}')
    return max(accumulate(steps), default=0)


def size_of(content: Any, known: dict[int, float]) -> float:
    """Return the number of values with all aliases expanded; infinite if it contains itself."""
    if not isinstance(content, (dict, list)):
        return 1.0
    if id(content) not in known:
        known[id(content)] = math.inf
        values = content.values() if isinstance(content, dict) else content
        known[id(content)] = 1.0 + sum(size_of(value, known) for value in values)
    return known[id(content)]


def or_default(value: Any, default: Any) -> Any:
    """Return the value of a key, or the default for an empty value."""
    return default if value is None else value
