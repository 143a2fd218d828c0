"""Makes untrusted text safe for a terminal: no control characters."""

from __future__ import annotations

from collections.abc import Sequence
import unicodedata

# Control characters, bidirectional controls and surrogates.
_UNSAFE = frozenset({'Cc', 'Cf', 'Cs', 'Co', 'Zl', 'Zp'})
_LAYOUT = frozenset('\n\t')


def list_names(names: Sequence[str], most: int) -> str:
    """Return the first names as text, with the number of the others."""
    more = f' and {len(names) - most} more' if len(names) > most else ''
    return ', '.join(names[:most]) + more


def printable(text: str) -> str:
    r"""Return a text with control characters escaped, e.g. '\x1b'; line breaks remain."""
    if text.isprintable():
        return text
    escaped = {
        ord(character): character.encode('unicode_escape', 'surrogatepass').decode('ascii')
        for character in set(text) - _LAYOUT
        if unicodedata.category(character) in _UNSAFE
    }
    return text.translate(escaped) if escaped else text
