"""Drop-ins: an identified or adaptive axis in the software that people scan with; each module needs its extra."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needed(package: str, extra: str) -> Iterator[None]:
    """Name the extra where an import within it fails.

    >>> with needed("a_scanner", "scanner"):
    ...     import a_scanner
    Traceback (most recent call last):
        ...
    ImportError: this needs the package a_scanner: pip install "truestroke[scanner]" (No module named 'a_scanner')
    """
    try:
        yield
    except ImportError as error:
        words = f'this needs the package {package}: pip install "truestroke[{extra}]" ({error})'
        raise ImportError(words, name=package) from error
