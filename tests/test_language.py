"""The language of the source tree: plain English with the nouns of the field."""

from pathlib import Path

import pytest

from tests.prose import RIDDLES, Prose, read_prose

FOLDERS = ("service", "training", "tests", "benchmarks")
# Imperatives that a docstring may start with, and nouns of the field, in the singular. A new term is added here.
VERBS = """
    accept add admit answer append apply ask attach await begin bind bound bring build call cancel change check
    choose clamp close collect combine compare compose compute convert copy count create cut decode decompress
    delete describe detect draw drop encode end estimate evaluate export extract fill find fit flush generate
    group hold include install judge keep kill label list listen load lock log look make mark match measure merge
    mirror model move multiply name normalise note number open parse pass pause perform pickle plan plot point
    poll predict prepare print probe publish push put raise read receive record recover refresh refuse register
    release remove rename render replace reply report reproduce request require reset resolve restart resume
    return roll rotate run sample save say scale scan select send serialise serve set share shift show shuffle
    sign simulate skip sort split stage start stop store submit sum swap take terminate test time train translate
    turn undo update use validate verify wait walk wrap write yield
""".split()  # noqa: SIM905 (a list would take a line for each)
TERMS = """
    admission alias angle answer api application architecture array attention augmentation benchmark body bodies
    bulk cache calibration callback caller camera card catalogue channel chunk client clock cluster column command
    condition config connection context counter coverage data dataset deadline declaration descriptor device
    diagnosis difference digest distance divergence docs domain encoder endpoint entry error example exception
    executor experiment fault field figure file finding folder friction gallery gate gauge gaussian geometry
    gradient grammar graph header health histogram history http id image indicator inference input inspection
    instance interval json kernel key layer layout length level likelihood limit location log loss manifest map
    marker mask material mean member message method metric micro-batching model name network neural noise
    normalisation note number object omnipush onnx onnxruntime option order orientation origin outcome outline
    output parameter parity parquet part patch path peer pixel plan plate plot point polygon pool port pose
    posterior precision prediction predictor prior probability probe problem process processor prometheus
    promotion property protocol publishing push pusher pushes quality quantile queries query queue range ratio
    readiness reading recipe record reference regression regulariser registry replica report reproduction request
    requirement response result retries retry reward ring root route row rule run runtime sample scale scene
    schema scope seam seed segment self-check sequence series server service session setting shape shard sharpness
    shortcut side signal signature simulation size slice snapshot soak socket solid source span spread standard
    statistic status step storage stream summary support surface symmetry table target telemetry tensor term text
    thread throughput thumbnail timeout timer timing token tolerance trace training transform transport tuple
    uncertainty unit upload validation value variance variant vector verdict verification version view visual
    warning weight wheel window word work worker workload world writer yaw
""".split()  # noqa: SIM905
OPENINGS = frozenset((*VERBS, *TERMS, "cazsl", "cazsl-train"))


@pytest.fixture(scope="module", params=FOLDERS)
def prose(request: pytest.FixtureRequest, project_root: Path) -> Prose:
    """The docstrings and comments of one top folder."""
    return read_prose(sorted((project_root / str(request.param)).rglob("*.py")))


def test_prose_names_things_instead_of_asking_what_they_are(prose: Prose) -> None:
    """At most 2 of 1,000 words are the question word."""
    assert prose.per_thousand("what") <= 2.0


def test_prose_has_no_riddles_for_subjects(prose: Prose) -> None:
    """At most 3 of 1,000 words are whoever, nobody, somebody, everybody or nothing."""
    assert prose.per_thousand(*RIDDLES) <= 3.0


def test_prose_has_one_idea_per_sentence(prose: Prose) -> None:
    """There are at most 4 semicolons per 1,000 words."""
    assert prose.semicolons_per_thousand() <= 4.0


def test_docstrings_start_with_a_verb_or_a_term_of_the_field(prose: Prose) -> None:
    """At least 70 % of docstrings name their subject in the first words."""
    others = prose.without_opening(OPENINGS)
    assert len(others) <= 0.3 * len(prose.docstrings), others[:20]


def test_a_riddle_is_counted() -> None:
    """The counters count: a text full of riddles is over every limit."""
    found = Prose(("What nobody knows; nothing else.",), ("Whoever reads this; somebody may.",))
    assert found.per_thousand("what") > 2.0
    assert found.per_thousand(*RIDDLES) > 3.0
    assert found.semicolons_per_thousand() > 4.0
    assert found.without_opening(OPENINGS) == ["What nobody knows; nothing else."]


def test_documents_have_lines_of_at_most_120_columns(project_root: Path) -> None:
    """A row of a table and a link cannot be broken; every other line can."""
    for path in [*sorted((project_root / "docs").glob("*.md")), project_root / "README.md"]:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert len(line) <= 120 or line.startswith("|") or "](" in line, f"{path.name}:{number}"
