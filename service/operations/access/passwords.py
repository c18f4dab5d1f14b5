"""Make and check passwords, keys and cookies. What is stored tells nobody what was sent."""

import base64
import hashlib
import hmac
import secrets
from functools import cache

#: A key is known by its beginning wherever it turns up by mistake.
KEY_PREFIX = "preload_"
_N_BYTES = 32
#: scrypt with 16 MiB and some 50 ms a try (RFC 7914; OWASP's smallest setting for it is 2^13 of this r with more p).
_N, _R, _P = 2**14, 8, 1
SHORTEST_PASSWORD = 10
LONGEST_PASSWORD = 200


def new_key() -> str:
    """Return a key that nobody can guess: 256 bits."""
    return KEY_PREFIX + secrets.token_urlsafe(_N_BYTES)


def new_token() -> str:
    """Return the value of a cookie: 256 bits."""
    return secrets.token_urlsafe(_N_BYTES)


def fingerprint(secret: str) -> str:
    """Return what is stored of a key or cookie. A quick hash will do: nobody guesses 256 bits."""
    return hashlib.sha256(secret.encode()).hexdigest()


def hashed_password(password: str) -> str:
    """Return what is stored of a password: the cost, salt and hash of scrypt."""
    salt = secrets.token_bytes(16)
    return f"scrypt${_N}${_R}${_P}${_text(salt)}${_text(_scrypt(password, salt, _N, _R, _P))}"


def is_password(password: str, stored: str) -> bool:
    """Tell whether a password is the one that was stored."""
    _, n, r, p, salt, expected = stored.split("$")
    given = _scrypt(password, base64.b64decode(salt), int(n), int(r), int(p))
    return hmac.compare_digest(given, base64.b64decode(expected))


@cache
def of_nobody() -> str:
    """Return the hash of no password: who asks for a user that does not exist waits as long as for one who does."""
    return hashed_password(secrets.token_urlsafe(_N_BYTES))


def _scrypt(password: str, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=n, r=r, p=p, dklen=32)


def _text(raw: bytes) -> str:
    return base64.b64encode(raw).decode()
