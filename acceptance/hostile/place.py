"""A case, its folder, and the components of its kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
import random
import shutil

from hostile.corpus import Corpus

Mutation = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One verb on one input.

    outputs: what it may write. read_back: a recording whose readings must be those of the whole
    one unless it is said to be damaged. room: bytes that may be written, None: any. kill:
    seconds after which it is killed, None for never. seconds: of the processor, for what computes
    long; None: those of all cases.
    """

    kind: str
    folder: Path
    words: tuple[str, ...]
    outputs: tuple[Path, ...] = ()
    read_back: Path | None = None
    room: int | None = None
    kill: float | None = None
    seconds: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of case: how many there are in a round, and how one is made."""

    weight: int
    make: Callable[[str, Path, Corpus, random.Random], Case]


@dataclass(slots=True)
class Place:
    """The folder of a case, with what it needs of the corpus."""

    kind: str
    folder: Path
    corpus: Corpus
    dice: random.Random
    outputs: list[Path] = field(default_factory=list)

    def take(self, name: str) -> Path:
        """Copy a whole input."""
        source, path = self.corpus.whole(name), self.folder / name
        if source.is_dir():
            shutil.copytree(source, path)
        else:
            shutil.copy(source, path)
        return path

    def mutate(self, path: Path, *mutations: Mutation) -> Path:
        """Change a file by one of these."""
        path.write_bytes(self.dice.choice(mutations)(path.read_bytes(), self.dice))
        return path

    def output(self, name: str) -> Path:
        """Name an output."""
        self.outputs.append(self.folder / name)
        return self.outputs[-1]

    def case(
        self, *words: object, read_back: Path | None = None, seconds: float | None = None
    ) -> Case:
        """Return the case that runs this verb."""
        texts = [str(word) for word in words]
        if self.dice.random() < 0.5:
            texts.append('--json')
        return Case(
            kind=self.kind,
            folder=self.folder,
            words=tuple(texts),
            outputs=tuple(self.outputs),
            read_back=read_back,
            seconds=seconds,
        )


Made = Callable[[Place], Case]


def made_kind(make: Made, weight: int) -> Kind:
    def made(kind: str, folder: Path, corpus: Corpus, dice: random.Random) -> Case:
        return make(Place(kind, folder, corpus, dice))

    return Kind(weight=weight, make=made)
