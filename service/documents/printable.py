"""Show a text that a stranger wrote: every character of it is seen, and none is obeyed."""

import unicodedata


def printable(text: str) -> str:
    r"""Return a text in which each character that is no visible letter or space stands as its code, on one line.

    Among them are ESC and with it every control sequence, BEL, line ends, and the marks that turn the direction of
    writing.

    Examples
    --------
    >>> printable("torque\x1b[2J")
    'torque\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(letter if _is_visible(letter) else repr(letter)[1:-1] for letter in text)


def _is_visible(letter: str) -> bool:
    """Tell whether a character is a letter, a sign or a space of any width."""
    return letter.isprintable() or unicodedata.category(letter) == "Zs"
