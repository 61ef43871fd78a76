"""Every file that truestroke writes: made beside its place, complete before it has its name, never over a stranger."""

import errno
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from truestroke.base import system
from truestroke.base.errors import TruestrokeError

HEAD = 4096  # bytes in which a text names what made it
INFLATION = 1100  # bytes of data in a byte of a file, at most: more than any compressor reaches with zeros
SLACK = 1 << 20  # bytes that any file may hold

_replacing: ContextVar[bool] = ContextVar("_replacing", default=False)


class FileError(TruestrokeError, ValueError):
    """A file that cannot be read as the expected kind; the message names the file and the reason."""


class FileTooLargeError(FileError):
    """A file that needs more memory than its size allows, or than this computer has."""


@dataclass(frozen=True)
class Kind:
    """A kind of file that truestroke writes.

    Attributes
    ----------
    words : str
        Such as "a model".
    ours : callable
        Whether the file of a path is one of this kind that truestroke wrote.
    ending : str
        What its name ends with, if it ends as a format does (`FORMATS`): ".toml"; "" for a kind of several formats.
    """

    words: str
    ours: Callable[[Path], bool]
    ending: str = ""


FORMATS = {
    *(".toml", ".html", ".h5", ".hdf5", ".csv", ".npz", ".npy", ".mat", ".json", ".yaml", ".yml", ".pkl", ".pdf"),
    *(".png", ".svg", ".xlsx", ".parquet", ".feather", ".tdms", ".sqlite", ".fmu", ".zip", ".c", ".py"),
}
"""Endings that say what a file is: another kind under such a name would be opened as what it is not."""


# ---- What may be replaced ------------------------------------------------------------------------------------------


def _begins(*marks: bytes) -> Callable[[Path], bool]:
    """Whether all of the marks are in the first bytes of a file."""

    def ours(path: Path) -> bool:
        with path.open("rb") as file:
            head = file.read(HEAD)
        return all(mark in head for mark in marks)

    return ours


def _arrays(path: Path) -> bool:
    """Whether it is an NPZ of a waveform."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as file:
            return {"volts.npy", "desired.npy", "predicted.npy"} <= set(file.namelist())
    except (zipfile.BadZipFile, OSError, NotImplementedError):
        return False


def _store(path: Path) -> bool:
    """Whether a study may continue in it: no tables of others; the study reports damage."""
    import sqlite3

    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            names = {name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    except sqlite3.Error:
        return True
    return not names or "study" in names


def _waveform_text(path: Path) -> bool:
    """Whether its first line is that of a waveform, with or without the passes before it."""
    with path.open("rb") as file:
        first = file.read(HEAD).split(b"\n")[0].decode("utf-8", "replace")
    return first == WAVEFORM_HEADER or first.startswith(f"{WAVEFORM_HEADER},{PASS_VOLTS.format(1)}")


PICTURES = (b"Software\0truestroke", b"<dc:title>truestroke</dc:title>", b"/Creator (truestroke)")  # PNG, SVG, PDF
WAVEFORM_HEADER = "time (s),volts (V),desired (um)"
PASS_VOLTS, PASS_MEASURED = "pass {} x (V)", "pass {} z (um)"  # further columns of a waveform that `refine` made
MODEL = Kind("a model", _begins(b'format = "truestroke model"'), ".toml")
DYNAMICS = Kind("dynamics", _begins(b'format = "truestroke dynamics"'), ".toml")
PAGE = Kind("a page", _begins(b'<meta name="generator" content="truestroke"'), ".html")
PICTURE = Kind("a picture", lambda path: any(mark in path.read_bytes() for mark in PICTURES))
RUNS = {"track", "run", "report", "serve"}  # whose page is that of one recording
STORE = Kind("a store of a study", _store)
WAVEFORM = Kind(
    "a waveform",
    lambda path: _arrays(path) if path.suffix == ".npz" else _waveform_text(path),
)
LINES_HEADER = "row,direction,start (s),end (s)"
LINES = Kind("a table of lines", _begins(LINES_HEADER.encode() + b"\n"))
SCAN_HEADER = "time (s),x (um),y (um),x velocity (um/s),y velocity (um/s),gate"
SCAN = Kind("the motion of a scan", _begins(SCAN_HEADER.encode() + b"\n"))
MEASUREMENT = Kind("a measurement", lambda path: False)  # a measurement is replaced on request only


def page(command: str) -> Kind:
    """A page that this command makes; one that does not say what made it may be any.

    Examples
    --------
    >>> page("identify").words
    'a page of truestroke identify'
    """
    if not command:
        return PAGE

    def ours(path: Path) -> bool:
        with path.open("rb") as file:
            made_by = re.search(rb'name="truestroke-command" content="([a-z]+)"', file.read(HEAD))
        maker = made_by[1].decode() if made_by else command
        return PAGE.ours(path) and (maker == command or {maker, command} <= RUNS)

    return Kind(f"a page of truestroke {command}", ours, PAGE.ending)


@contextmanager
def overwriting(yes: bool = True) -> Iterator[None]:
    """Within it, files of others may be replaced."""
    before = _replacing.set(yes)
    try:
        yield
    finally:
        _replacing.reset(before)


def replacing() -> bool:
    """Whether files of others may be replaced: within `overwriting`."""
    return _replacing.get()


def check(path: str | os.PathLike[str], kind: Kind) -> Path:
    """Path of a file of `kind` to be written, if permitted: a link is followed.

    Raises
    ------
    FileError
        The name ends as that of another format.
    FileExistsError
        A file is there that truestroke did not write, or not as this kind, and `overwriting` does not permit it.
    OSError
        There is no folder, or the place is one, or it cannot be written.

    Examples
    --------
    >>> check("model.h5", MODEL)
    Traceback (most recent call last):
    truestroke.FileError: model.h5: a model is no .h5 file; call it model.toml
    """
    path = Path(path)
    if kind.ending and path.suffix.lower() in FORMATS - {kind.ending}:
        raise FileError(f"{path}: {kind.words} is no {path.suffix} file; call it {path.with_suffix(kind.ending).name}")
    place = path.resolve() if path.is_symlink() and (path.is_file() or not path.exists()) else path
    _check_place(place, path)
    if place.is_file() and not _replacing.get() and place.stat().st_size and not kind.ours(place):
        what = "is there already" if kind is MEASUREMENT else f"is there and is not {kind.words} that truestroke wrote"
        raise FileExistsError(errno.EEXIST, f"{what}; choose another name, or `overwrite` it", str(path))
    return place


def no_folder(folder: Path, named: Path) -> FileNotFoundError:
    """The error of a file or folder `named` that has no folder to be in, with the command that makes it."""
    made = system.command_line(*system.MAKE_FOLDER, folder)
    return FileNotFoundError(errno.ENOENT, f"there is no folder {folder}; make it: {made}", str(named))


def _check_place(place: Path, named: Path) -> None:
    """The folder is there, the place is none, and it can be written."""
    if not place.parent.is_dir():
        raise no_folder(place.parent, named)
    if place.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder; name a file", str(named))
    if not os.access(place if place.exists() else place.parent, os.W_OK):
        raise PermissionError(errno.EACCES, "cannot be written: no permission; choose another folder", str(named))


# ---- Writing -------------------------------------------------------------------------------------------------------


@contextmanager
def writing(path: str | os.PathLike[str], kind: Kind) -> Iterator[Path]:
    """A draft beside `path` to be written; it is synchronised and renamed when the block ends, and removed at an error.

    A file of that name is either unchanged, or replaced by a complete one.

    Raises
    ------
    OSError
        As `check`, or the disk took not all of it.
    """
    place = check(path, kind)
    if place.exists() and not place.is_file():  # a device or a pipe takes no other name
        yield place
        return
    draft = place.with_name(f".{place.stem}.{os.getpid()}.tmp{place.suffix}")
    try:
        yield draft
        with draft.open("rb+") as file:
            os.fsync(file.fileno())
        if place.exists():
            draft.chmod(place.stat().st_mode & 0o7777)
        draft.replace(place)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(draft)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        draft.unlink(missing_ok=True)


def write(path: str | os.PathLike[str], text: str, kind: Kind) -> Path:
    """Write a text as a file of `kind`; its path."""
    with writing(path, kind) as draft:
        draft.write_text(text, encoding="utf-8")
    return Path(path)


# ---- A file that others read while it grows ------------------------------------------------------------------------


@dataclass(frozen=True)
class Growing:
    """A file that is written for a while, open and locked in this process and in those that inherit the descriptor.

    Attributes
    ----------
    path : Path
        Where it is written.
    final : Path
        What it is called when it is complete: the same, or a file that is replaced then.
    descriptor : int
        Of the open file, whatever name it has.
    """

    path: Path
    final: Path
    descriptor: int

    def __reduce__(self) -> tuple[Callable[..., "Growing"], tuple[Path, Path, int]]:
        if system.INHERITS:
            return Growing, (self.path, self.final, self.descriptor)  # to a process that has inherited the descriptor
        return _reopened, (self.path, self.final, self.descriptor)

    @property
    def name(self) -> str:
        """By which a library can open the file that is locked, whatever has its path; the path where there is none."""
        return system.name_of(self.descriptor, self.where)

    @property
    def where(self) -> Path:
        """What it is called now."""
        return self.final if self._is(self.final) else self.path

    def complete(self) -> None:
        """Synchronise it and give it its final name; not onto a file that another process writes."""
        os.fsync(self.descriptor)
        if self.path != self.final and self._is(self.path):
            if self.final.exists() and busy(self.final):
                raise BlockingIOError(errno.EAGAIN, f"another run writes it; this one is {self.path}", str(self.final))
            self.path.replace(self.final)

    def write(self, offset: int, data: bytes) -> None:
        """Write bytes into the open file, all of them."""
        while data:
            done = system.write_at(self.descriptor, data, offset)
            offset, data = offset + done, data[done:]

    def discard(self) -> None:
        """Remove it: nothing was put into it."""
        if self._is(self.path):
            self.path.unlink()

    def close(self) -> None:
        """Let go of it."""
        os.close(self.descriptor)

    def _is(self, path: Path) -> bool:
        """Whether a path names the open file."""
        try:
            return os.path.samestat(os.stat(path), os.fstat(self.descriptor))
        except OSError:
            return False


def _reopened(path: Path, final: Path, _: int) -> Growing:
    """In a process that cannot inherit the descriptor."""
    return Growing(path, final, system.reopen(path))


def set_aside(paths: Sequence[Path]) -> list[Path]:
    """Rename those of the files that are there to NAME-1, or to the first number that none of them has; the new names.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> for name in ("a.csv", "a.toml", "a-1.toml"):
    ...     _ = (folder / name).write_text(name)
    >>> [one.name for one in set_aside([folder / "a.csv", folder / "a.toml", folder / "a.html"])]
    ['a-2.csv', 'a-2.toml']
    """
    number = 1
    while any(path.with_stem(f"{path.stem}-{number}").exists() for path in paths):
        number += 1
    there = [path for path in paths if path.exists()]
    return [path.rename(path.with_stem(f"{path.stem}-{number}")) for path in there]


def beside(final: Path) -> Path:
    """What a file is called until it is complete and replaces `final`."""
    return final.with_name(f"{final.stem}.new{final.suffix}")


def check_growing(final: Path, overwrite: bool, empty: Callable[[Path], bool]) -> Path:
    """Where a file that will be `final` is to be written: under its own name where there is none, else beside it.

    With `overwrite` it may replace what is there; `empty` says whether an earlier run's file `beside` it has no data.

    Raises
    ------
    FileExistsError
        The file exists, or another process writes it, or the data of a killed process are beside it.
    OSError
        There is no folder, or the place is one.
    """
    _check_place(final, final)
    if not final.exists():
        return final
    path = beside(final)
    for file in (final, path):
        if file.exists() and busy(file):
            raise FileExistsError(errno.EEXIST, "another run is writing it; choose another name", str(file))
    if not overwrite:
        raise FileExistsError(errno.EEXIST, "a recording is there; choose another name, or `overwrite` it", str(final))
    if path.exists() and not empty(path):
        message = f"a run that ended early left it; keep it by another name (mv), or remove it, to replace {final.name}"
        raise FileExistsError(errno.EEXIST, message, str(path))
    return path


def grow(final: Path, overwrite: bool, empty: Callable[[Path], bool]) -> Growing:
    """Make and lock the file that `check_growing` finds a place for; what raises is the same."""
    path = check_growing(final, overwrite, empty)
    if path != final:
        path.unlink(missing_ok=True)
    descriptor = system.create(path)
    system.lock(descriptor)
    return Growing(path, final, descriptor)


def busy(path: Path) -> bool:
    """Whether some process has the file as `Growing`."""
    try:
        descriptor = os.open(path, os.O_RDONLY | system.OPEN)
    except OSError:
        return False
    try:
        return system.locked(descriptor)
    finally:
        os.close(descriptor)


# ---- Reading -------------------------------------------------------------------------------------------------------


def existing(path: Path) -> Path:
    """The same path, of a file that is there.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
        There is none, or it is a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder; name a file", str(path))
    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, "no such file", str(path))
    return path


@contextmanager
def reading(path: str | os.PathLike[str], wrong: Callable[[str], FileError]) -> Iterator[None]:
    """Every error of a library at a damaged file becomes one line: ``wrong(reason)``.

    A `FileError` and an `OSError` that names its file pass.
    """
    try:
        yield
    except (FileError, FileNotFoundError, PermissionError, IsADirectoryError):
        raise
    except Exception as error:  # readers of foreign formats raise many kinds
        message = " ".join(str(error).split()) or type(error).__name__
        raise wrong(f"the file is damaged ({message[:200]})") from error


def check_size(path: str | os.PathLike[str], what: str, size: int) -> None:
    """Refuse, before memory is allocated, what a file of this size cannot contain or this computer cannot store.

    `what` of the file is to be read, and takes `size` bytes of memory.
    """
    held = INFLATION * Path(path).stat().st_size + SLACK
    if size > held:
        reason = f"of {_bytes(held)} at most, which is what a file of {_bytes(Path(path).stat().st_size)} can hold"
    elif size > (room := system.memory() // 2):
        reason = f"of {_bytes(room)} at most, half of this computer's memory"
    else:
        return
    raise FileTooLargeError(f"{os.fspath(path)}: {what} needs {_bytes(size)} of memory: must be {reason}")


def _bytes(size: int) -> str:
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB" if size >= 1e6 else f"{size / 1e3:.3g} kB"
