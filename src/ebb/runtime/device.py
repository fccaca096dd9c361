"""What a device is to the backends: it loads object code, and runs it over blocks of rows."""

from __future__ import annotations

from typing import Any, Protocol


class Code(Protocol):
    """Object code that has been loaded and can be launched for as long as this object lives."""

    @property
    def name(self) -> str:
        """That of the kernel."""
        ...


class Device(Protocol):
    """Somewhere kernels run."""

    @property
    def name(self) -> str:
        """What messages call the device."""
        ...

    def load(self, name: str, image: bytes) -> Any:
        """The object code ``image`` made ready to run.

        Raises:
            BackendError: it cannot be loaded here.
        """
        ...

    def describe(self) -> str:
        """The device in words, for ``ebb info``."""
        ...
