"""Access to the numbers of a model by dotted path."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError


def unknown_quantity(name: str) -> str:
    """Return the message for a name that is not a quantity of the model."""
    return (
        f'the model has no quantity {name}; valid names are, for example, arm.length, '
        'intrinsic_curvature.curvature.3.5, moment_law.rigidity.0.1, effects.gravity.weight_y'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """A change of the number at a path; `name` is for messages."""

    path: tuple[str, ...]
    amount: float
    name: str

    def inside(self) -> Move:
        """Return the move with the path one level deeper."""
        return Move(path=self.path[1:], amount=self.amount, name=self.name)


def move_numbers(owner: Any, moves: Sequence[Move]) -> Any:
    """Return a copy of `owner` with the numbers at these paths increased."""
    if not moves:
        return owner
    at_root = next((move for move in moves if not move.path), None)
    if at_root is not None:
        if isinstance(owner, bool) or not isinstance(owner, (int, float)):
            raise ModelError(unknown_quantity(at_root.name), reason='unknown_quantity')
        return float(owner) + sum(move.amount for move in moves)
    if isinstance(owner, np.ndarray):
        return move_cells(owner, moves)
    by_key: dict[str, list[Move]] = {}
    for move in moves:
        by_key.setdefault(move.path[0], []).append(move.inside())
    known: list[str] = []
    if isinstance(owner, tuple):
        known = [effect.name for effect in owner]
    elif dataclasses.is_dataclass(owner):
        known = [item.name for item in dataclasses.fields(owner) if item.init]
    for key, inside in by_key.items():
        if key not in known:
            raise ModelError(unknown_quantity(inside[0].name), reason='unknown_quantity')
    if isinstance(owner, tuple):
        return tuple(move_numbers(effect, by_key.get(effect.name, [])) for effect in owner)
    changes = {key: move_numbers(getattr(owner, key), inside) for key, inside in by_key.items()}
    return dataclasses.replace(owner, **changes)


def move_cells(table: Array, moves: Sequence[Move]) -> Array:
    """Return a copy of a table with the cells at these paths increased."""
    copy = np.array(table)
    for move in moves:
        if not all(item.isdecimal() for item in move.path) or len(move.path) != copy.ndim:
            raise ModelError(unknown_quantity(move.name), reason='unknown_quantity')
        try:
            copy[tuple(int(item) for item in move.path)] += move.amount
        except IndexError:
            raise ModelError(unknown_quantity(move.name), reason='unknown_quantity') from None
    return copy
