"""Zero-shot and few-shot answers about new objects: which objects are new, and the page of the benchmark."""

import json
from pathlib import Path

import pytest

from benchmarks import few_shot
from service.pushing.contexts import ObjectContext
from training.omnipush.published import omnipush_descriptors


def test_new_objects_are_none_of_omnipush_in_any_frame() -> None:
    """Objects have at most two weights, and no turned or mirrored form of one is another one or one of Omnipush's."""
    found = few_shot.new_objects(40, seed=1)
    assert found == few_shot.new_objects(40, seed=1)
    forms = [set(few_shot._forms(name)) for name in found]
    known = set(omnipush_descriptors())
    for place, name in enumerate(found):
        assert sum(side.weight != "a" for side in ObjectContext.from_descriptor(name).sides) <= 2
        assert not forms[place] & known
        assert not any(other in forms[place] for other in found[:place])


def test_mirrored_sides_swap_their_places() -> None:
    """The forms of an object are its turns and those of its mirror image, where second and fourth side are swapped."""
    found = set(few_shot._forms("1a2b3c4a"))
    assert {"1a2b3c4a", "4a1a2b3c", "1a4a3c2b"} <= found
    assert len(found) == 8


def test_the_page_compares_all_models_on_the_same_pushes(project_root: Path, tmp_path: Path) -> None:
    """Every model has a row, the meta-learner one for each number of pushes, and the figures are beside the page."""
    out = tmp_path / "page"
    few_shot.main(
        ["--objects", "2", "--pushes", "60", "--models-folder", str(project_root / "models"), "--out", str(out)]
    )
    page, figures = (out / few_shot.PAGE_FILE).read_text("utf-8"), json.loads((out / few_shot.FIGURES_FILE).read_text())
    assert (figures["pushes"], figures["objects"]) == (20, 2)
    names = [name.partition(": ")[2] for name in figures["scores"]]
    pushes = [f"{count} push{'es' if count > 1 else ''} of it" for count in few_shot.COUNTS]
    assert names == ["nothing", "its sides and weights", "its outline", *pushes]
    for name, found in figures["scores"].items():
        assert f"| {name} | {found['position_mm']['mean']:.2f} (" in page
    assert "python -m benchmarks.few_shot --objects 2 --pushes 60" in page


def test_a_benchmark_without_targets_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """As many pushes as a support has leave none to predict."""
    with pytest.raises(SystemExit):
        few_shot.main(["--pushes", "50"])
    assert "more than 50" in capsys.readouterr().err
