"""What the image is made of is locked: versions that fit, with their digests, in a form that pip takes."""

import re
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires

import pytest
from packaging.requirements import Requirement

from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LINE = re.compile(r"^([a-z0-9-]+)(?:\[([a-z,-]+)\])?==([^ ;\\]+).*?(\\\n +--hash=sha256:|$)", re.MULTILINE)
EXTRAS = {"serving": (), "s3": ("s3",), "all": ("s3", "signing", "otel")}


def lines(lock: str) -> list[tuple[str, str, str, str]]:
    """Name, extras, version and whether a digest follows, for every line of a lock that pins one."""
    found: list[tuple[str, str, str, str]] = LINE.findall((ROOT / "deploy" / "locks" / f"{lock}.txt").read_text())
    assert found
    return found


def wanted(name: str) -> Iterator[Requirement]:
    """What a package asks for here; nothing when it is one for other systems."""
    try:
        asked = requires(name) or []
    except PackageNotFoundError:
        return
    for one in map(Requirement, asked):
        if one.marker is None or one.marker.evaluate({"extra": ""}):
            yield one


@pytest.mark.parametrize("lock", EXTRAS)
def test_the_image_holds_versions_that_fit_what_is_declared(lock: str) -> None:
    """``make lock`` was run after the last change of dependencies; each version has its digests."""
    assert all(digest for _, _, _, digest in lines(lock))
    pinned = {name: version for name, _, version, _ in lines(lock)}
    declared = [
        *PROJECT["dependencies"],
        *(entry for extra in EXTRAS[lock] for entry in PROJECT["optional-dependencies"][extra]),
    ]
    for requirement in map(Requirement, declared):
        assert pinned[requirement.name] in requirement.specifier, requirement


@pytest.mark.parametrize("lock", EXTRAS)
def test_what_is_wanted_with_an_extra_is_pinned_with_it(lock: str) -> None:
    """Else pip, which is asked for digests, finds no pin for it and installs nothing."""
    pinned = {name: set(extras.split(",")) for name, extras, _, _ in lines(lock)}
    for name in pinned:
        for requirement in wanted(name):
            if requirement.extras:
                assert requirement.extras <= pinned[requirement.name], (name, str(requirement))
