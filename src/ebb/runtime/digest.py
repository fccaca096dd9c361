"""Digests of what code depends on."""

from __future__ import annotations

try:  # what hashlib has, without OpenSSL, which takes 2 ms to load
    from _blake2 import blake2b
except ImportError:
    from hashlib import blake2b

DIGEST_BYTES = 32


def key_of(*parts: str | bytes | memoryview) -> str:
    """The name under which what depends on ``parts`` is kept."""
    digest = blake2b(digest_size=DIGEST_BYTES)
    for part in parts:
        content = part.encode() if isinstance(part, str) else part
        digest.update(f"{len(content)}:".encode())
        digest.update(content)
    return digest.hexdigest()


def checksum(key: str, image: bytes) -> bytes:
    """What ``image`` under the name ``key`` is known by."""
    digest = blake2b(key.encode(), digest_size=DIGEST_BYTES)
    digest.update(image)
    return digest.digest()
