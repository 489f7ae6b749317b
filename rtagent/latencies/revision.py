"""Another revision of this git repository, installed beside: in an environment of its own, in a cache folder.

Packages that it needs are those of this interpreter, where they will do: so what is compared differs in nothing
else, and little has to be installed.
"""

from __future__ import annotations

import os
import shutil
import site
import subprocess
import sysconfig
import venv
from collections.abc import Callable
from pathlib import Path

from rtagent.errors import BaselineError

HERE = "_packages_of_the_other_environment.pth"
READY = "ready"
TOLD = 15
"""So many of the last lines of a program that failed are told."""


def installed(revision: str, tell: Callable[[str], None], repository: Path | None = None) -> Path:
    """Return the interpreter of the environment that a revision is installed in; install it, where it is not yet.

    Raises `BaselineError` where there is no such revision, or it cannot be installed.
    """
    root = Path(_git("rev-parse", "--show-toplevel", folder=repository or Path.cwd()))
    commit = _commit(revision, root)
    home = _cache() / f"{commit[:16]}-{sysconfig.get_python_version()}"
    python = home / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
    if not (home / READY).exists():
        tell(f"installing {revision} in {home}, once")
        shutil.rmtree(home, ignore_errors=True)
        source = home / "source"
        _git("clone", "--quiet", "--shared", "--no-checkout", str(root), str(source), folder=root)
        _git("checkout", "--quiet", "--detach", commit, folder=source)
        _install(source, home / "venv", python)
        (home / READY).touch()
    return python


def _commit(revision: str, root: Path) -> str:
    try:
        return _git("rev-parse", "--verify", "--end-of-options", f"{revision}^{{commit}}", folder=root)
    except BaselineError:
        raise BaselineError(
            f"{root} has no revision {revision!r}: give a branch, a tag or a commit, such as main."
        ) from None


def _cache() -> Path:
    """Return the folder of all revisions; none of its parts is called as the package is, by which code is named."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "rtagent-revisions"


def _install(source: Path, folder: Path, python: Path) -> None:
    """Make an environment that sees the packages of this one, and install the source there."""
    venv.create(folder, with_pip=True)
    theirs = sysconfig.get_path("purelib", "venv", {"base": str(folder), "platbase": str(folder)})
    lines = [f"import site; site.addsitedir({place!r})\n" for place in _own_packages()]
    (Path(theirs) / HERE).write_text("".join(lines), encoding="utf-8")
    _done([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", str(source)], source)


def _own_packages() -> list[str]:
    return site.getsitepackages() + ([site.getusersitepackages()] if site.ENABLE_USER_SITE else [])


def _git(*arguments: str, folder: Path) -> str:
    return _done(["git", *arguments], folder).strip()


def _done(command: list[str], folder: Path) -> str:
    """Run a program and return what it printed; raise `BaselineError` with its last lines where it failed."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603
    except OSError as error:
        raise BaselineError(f"{command[0]} cannot be run: {error.strerror}.") from None
    if done.returncode:
        said = "\n".join((done.stderr or done.stdout).strip().splitlines()[-TOLD:])
        raise BaselineError(f"`{' '.join(command)}` failed{': ' * bool(said)}{said}")
    return done.stdout
