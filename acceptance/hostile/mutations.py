"""Mutations of bytes, texts and files, drawn by a seeded generator."""

from __future__ import annotations

import os
from pathlib import Path
import random
import re

NUMBER = re.compile(rb'-?\d+\.?\d*(?:[eE][-+]?\d+)?')
NUMBERS = (
    b'0',
    b'-1',
    b'1e300',
    b'-1e300',
    b'1e-300',
    b'.inf',
    b'-.inf',
    b'.nan',
    b'nan',
    b'inf',
    b'1e999',
    b'9223372036854775808',
    b'18446744073709551616',
    b'99999999999999999999999999999999999999',
    b'null',
    b'',
    b'true',
    b'[]',
    b'{}',
    b'"1"',
    b'1_000',
    b'0x10',
    b'1e5',
    b'100000',
    b'2001-01-01',
)
SCRAPS = (
    b'\0',
    b'\x1b[31m',
    b'\x1b]0;owned\x07',
    b'[/]',
    b'[bold]',
    b'[link=http://x]',
    b'\xff',
    b'\xed\xa0\x80',
    b'\xe2\x80\xae',
    b'\r',
    b'\n',
    b'\t',
    b'- ',
    b': ',
    b'#',
    b'&a ',
    b'*a',
    b'<<: *a',
    b'!!python/name:os.system',
    b'"\\ud800"',
    b'"\\0"',
    b"'",
    b'"',
    b'{',
    b'[',
    b']',
    b'}',
    b',',
    b';',
    b'\xef\xbb\xbf',
    b'A' * 5000,
    b'[' * 200,
    b'../',
    b'/etc/passwd',
    b'/dev/zero',
    b'$x^{',
    b'%s',
    b'{0}',
    b'\\',
)
EXTREMES = (b'\xff', b'\0', b'\x7f', b'\x80')


def flip_bit(raw: bytes, dice: random.Random) -> bytes:
    """Flip one bit."""
    changed = bytearray(raw)
    changed[dice.randrange(len(raw))] ^= 1 << dice.randrange(8)
    return bytes(changed)


def damage_bytes(raw: bytes, dice: random.Random) -> bytes:
    """Set, fill, cut out, put in, double or cut off some bytes."""
    changed = bytearray(raw)
    for _ in range(dice.randint(1, 6)):
        place, length = dice.randrange(len(changed) + 1), dice.choice((1, 1, 2, 4, 8, 16, 200))
        kind = dice.randrange(6)
        if kind == 0 and place < len(changed):
            changed[place] = dice.randrange(256)
        elif kind == 1:
            changed[place : place + length] = dice.choice(EXTREMES) * length
        elif kind == 2:
            del changed[place : place + length]
        elif kind == 3:
            changed[place:place] = dice.randbytes(length)
        elif kind == 4:
            changed[place:place] = changed[place : place + length]
        elif dice.random() < 0.3:
            del changed[place:]
    return bytes(changed)


def damage_text(raw: bytes, dice: random.Random) -> bytes:
    """Put other numbers and scraps into a text, and drop or double lines."""
    changed = raw
    for _ in range(dice.choice((1, 1, 2, 3))):
        kind, numbers = dice.randrange(8), list(NUMBER.finditer(changed))
        if kind > 3 and numbers:
            found = dice.choice(numbers)
            number = dice.choice(NUMBERS) if kind == 4 else scaled(found[0], dice)
            changed = changed[: found.start()] + number + changed[found.end() :]
        elif kind == 0:
            place = dice.randrange(len(changed) + 1)
            end = place + dice.randrange(8)
            changed = changed[:place] + dice.choice(SCRAPS) + changed[end:]
        else:
            lines = changed.split(b'\n')
            place = dice.randrange(len(lines))
            if kind == 1:
                del lines[place]
            else:
                lines[place:place] = [lines[place]] * dice.choice((1, 1, 50))
            changed = b'\n'.join(lines)
    return changed


def scaled(number: bytes, dice: random.Random) -> bytes:
    """Return another number of a size like this one's, which mostly is allowed in its place."""
    return b'%.6g' % (
        float(number) * dice.choice((-1.0, 1.0, 1.0, 1.0)) * 10.0 ** dice.gauss(0, 0.5)
    )


def replace_by_no_file(path: Path, dice: random.Random) -> None:
    """Put what is no file of bytes, or one of none or very many, where a file was."""
    path.unlink()
    kind = dice.randrange(8)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to('/dev/zero')
    elif kind == 2:
        path.symlink_to('nowhere')
    elif kind == 3:
        path.mkdir()
    elif kind == 4:
        path.write_bytes(b'')
    elif kind == 5:
        path.symlink_to(path.name)
    elif kind == 6:
        path.symlink_to('/proc/self/mem')
    else:
        with path.open('wb') as stream:
            stream.truncate(8_000_000_000)
