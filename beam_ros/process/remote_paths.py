"""Paths of what lies in an object store or behind another protocol, with as much of ``Path`` as reading needs.

``fsspec`` opens what a URL names (``s3://bucket/run``, ``memory://run``) and reads ranges of it. It is an extra, and
imported only when such a path is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import IO, Any

from beam_ros.errors import UsageError

_READ_AHEAD = 128 * 1024
"""What is asked for beyond a range [bytes], so that many small reads are few requests."""


class RemotePath:
    """A file or folder that a URL names.

    Parameters
    ----------
    url : str -- "protocol://..."

    Raises
    ------
    UsageError
        The protocol is not known, or what serves it is not installed.
    """

    def __init__(self, url: str, _store: Any = None) -> None:
        self._url = url.rstrip("/")
        self._store = _store or _store_of(url)
        self._inner: str = self._store._strip_protocol(self._url)

    def __str__(self) -> str:
        return self._url

    def __truediv__(self, name: object) -> RemotePath:
        return RemotePath(f"{self._url}/{name}", self._store)

    @property
    def name(self) -> str:
        """The last part."""
        return PurePosixPath(self._inner).name

    @property
    def suffix(self) -> str:
        """What the name ends with, from its last dot on."""
        return PurePosixPath(self._inner).suffix

    @property
    def parent(self) -> RemotePath:
        """What it lies in."""
        return RemotePath(self._url.rpartition("/")[0], self._store)

    def resolve(self) -> RemotePath:
        """Return itself: a URL names the same from everywhere."""
        return self

    @property
    def stem(self) -> str:
        """The name without its suffix."""
        return PurePosixPath(self._inner).stem

    @cached_property
    def _info(self) -> dict[str, Any] | None:
        try:
            info: dict[str, Any] = self._store.info(self._inner)
        except FileNotFoundError:
            return None
        except Exception as err:
            raise _unreachable(self._url, err) from err
        return info

    def exists(self) -> bool:
        """Whether there is something."""
        return self._info is not None

    def is_file(self) -> bool:
        """Whether it is a file."""
        return self._info is not None and self._info["type"] == "file"

    def is_dir(self) -> bool:
        """Whether it is a folder."""
        return self._info is not None and self._info["type"] == "directory"

    def stat(self) -> SimpleNamespace:
        """Return the size as ``st_size`` [bytes]."""
        return SimpleNamespace(st_size=self._info["size"] if self._info else 0)

    def iterdir(self) -> Iterator[RemotePath]:
        """Yield what is in the folder."""
        for inner in self._store.ls(self._inner, detail=False):
            yield self / PurePosixPath(inner).name

    def open(self, mode: str = "rb") -> IO[bytes]:
        """Open the file for reading bytes."""
        stream: IO[bytes] = self._store.open(
            self._inner, mode, block_size=_READ_AHEAD, cache_type="readahead"
        )
        return stream

    def read_text(self, encoding: str = "utf-8") -> str:
        """Return the file as text."""
        data: bytes = self._store.cat_file(self._inner)
        return data.decode(encoding)


AnyPath = Path | RemotePath


def any_path(text: str) -> AnyPath:
    """Return the path that a text names: a URL's or one of this machine's."""
    return RemotePath(text) if "://" in text else Path(text)


def _store_of(url: str) -> Any:
    try:
        from fsspec.core import url_to_fs
    except ImportError as err:
        raise UsageError(
            f"{url}: what lies elsewhere is read with fsspec, which is not installed; install this package with its "
            "`remote` extra, or copy the bag here"
        ) from err
    try:
        return url_to_fs(url)[0]
    except Exception as err:
        raise _unreachable(url, err) from err


def _unreachable(url: str, err: Exception) -> UsageError:
    """Return what to say of whatever a store's library raises: each has exceptions of its own."""
    return UsageError(
        f"{url}: cannot be reached ({str(err) or type(err).__name__}); expected a protocol that is installed "
        "(s3fs for s3://: the `remote` extra), the store's address and keys; mend that, or copy the bag here"
    )
