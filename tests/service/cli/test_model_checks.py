"""``verify`` and ``doctor`` judge a registry as the service does: by its settings, by every check, and by the gates."""

from pathlib import Path

import pytest

from service.registry.registry import Registry
from tests.service.cli.command_line import NAME, document, force, run
from tests.service.registry.test_signing import key_pair


def demand(monkeypatch: pytest.MonkeyPatch, folder: Path, **settings: object) -> None:
    """Write these settings into the file that CAZSL_CONFIG names."""
    file = folder / "cazsl.toml"
    file.write_text("".join(f"{name} = {str(value)!r}\n" for name, value in settings.items()), encoding="utf-8")
    monkeypatch.setenv("CAZSL_CONFIG", str(file))


@pytest.mark.parametrize("by", ["environment", "file"])
def test_a_version_without_a_demanded_signature_is_broken(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    """A version that the service would refuse is broken for ``verify`` and ``doctor``, and is not promoted."""
    private, public = key_pair(tmp_path, "trusted")
    force(root, 1)
    assert run(root, "doctor").exit_code == 0
    if by == "file":
        demand(monkeypatch, tmp_path, require_signature=public)
    else:
        monkeypatch.setenv("CAZSL_REQUIRE_SIGNATURE", str(public))
    found = document(root, "verify", status=1)
    assert [(line["ok"], "signature: there is none" in line["detail"]) for line in found] == [(False, True)] * 2
    result = run(root, "doctor")
    assert result.exit_code == 1
    assert f"sign it (cazsl models sign {NAME}@1 --key KEY)" in result.output
    for command in (("promote", NAME, "2", "--force", "--reason", "x"), ("rollback", NAME, "--yes")):
        result = run(root, *command)
        assert result.exit_code in (1, 5)
    assert Registry(root).aliases(NAME) == {"champion": 1}
    for version in (1, 2):
        assert run(root, "sign", f"{NAME}@{version}", "--key", str(private)).exit_code == 0
    assert all(line["ok"] for line in document(root, "verify"))
    assert run(root, "doctor").exit_code == 0
    for words in ("list", f"show {NAME}", f"diff {NAME}@1 {NAME}@2", f"history {NAME}"):
        assert run(root, *words.split()).exit_code == 0


def test_a_model_that_is_too_large_for_the_service_is_broken(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The maximum size of a model is that of the service."""
    monkeypatch.setenv("CAZSL_MAX_MODEL_BYTES", "1024")
    assert "more than 1024 bytes" in document(root, "verify", status=1)[0]["detail"]
    assert run(root, "doctor").exit_code == 1


def test_a_setting_that_is_wrong_ends_the_command(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A trusted key that cannot be read is named. No version is judged without it."""
    monkeypatch.setenv("CAZSL_REQUIRE_SIGNATURE", str(root / "gone.pem"))
    for command in ("verify", "doctor"):
        result = run(root, command)
        assert (result.exit_code, "gone.pem: cannot be read" in result.output) == (1, True)
        assert "no faults" not in result.output


def test_gates_judge_versions_that_are_asked_for_or_served(root: Path) -> None:
    """A refused version has exit status 3 if it is asked for, or if an alias names it and was not forced to."""
    result = run(root, "verify", f"{NAME}@2")
    assert result.exit_code == 3
    assert f"{NAME}@2  ok, but gates refuse it: no-contact 1.04 > 0.121, angle-at-pi" in result.output
    assert document(root, "verify", status=3)[0]["refused"].startswith("no-contact")
    assert run(root, "doctor").exit_code == 1
    force(root, 1)
    assert run(root, "verify").exit_code == 0
    result = run(root, "doctor")
    assert result.exit_code == 0
    assert f"note    {NAME}@champion: names version 1, which gates refuse: no-contact" in result.output
    assert "(its promotion was forced)" in result.output
    Registry(root).drop_alias(NAME, "champion")
    assert run(root, "verify").exit_code == 0
    assert run(root, "doctor").output == "no faults found\n"
