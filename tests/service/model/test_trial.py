"""Trials of graphs in a process of their own: results are kept, and a process that fails is an error of the tree."""

import os
import resource
import time
from pathlib import Path

import pytest

from service.errors import BrokenModelError, RegistryError
from service.model.tensors import ContextKind
from service.model.trial import Trials
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from tests.attacks.hostile_graphs import ATTACKS, valid_graph

TENSORS = expected_inputs(ContextKind.NONE), OUTPUTS
VALID = valid_graph().SerializeToString()


def script(*lines: str) -> tuple[str, str]:
    """Return the arguments of a trial process that reads its first request and then runs these lines."""
    read = "import sys, os, signal, time; n = eval(input())['bytes']; sys.stdin.buffer.raw"
    return "-c", "\n".join((read, *lines))


def test_a_graph_is_tried_once_and_another_one_by_the_same_process(tmp_path: Path) -> None:
    """A size or a refusal is remembered. The process is started for the first graph and tries the next ones too."""
    count = tmp_path / "started"
    code = f"open({str(count)!r}, 'a').write('x'); from service.model.trial_process import main; main()"
    trials = Trials(["-c", code])
    size = trials.result(VALID, *TENSORS)
    assert size.row_bytes == 24  # mean and std
    hostile = ATTACKS["expansion"][0]().SerializeToString()
    for _ in range(3):
        assert trials.result(VALID, *TENSORS) == size
        with pytest.raises(BrokenModelError, match="elements per row"):
            trials.result(hostile, *TENSORS)
    assert count.read_text() == "x"
    trials.close()
    assert trials.result(VALID, *TENSORS) == size
    assert count.read_text() == "x"


def test_a_process_that_was_started_ahead_is_the_one_that_tries(tmp_path: Path) -> None:
    """A process can be started before there is a graph. A second start has no effect, and a failed one no error."""
    count = tmp_path / "started"
    code = f"open({str(count)!r}, 'a').write('x'); from service.model.trial_process import main; main()"
    trials = Trials(["-c", code])
    trials.start()
    trials.start()
    assert trials.result(VALID, *TENSORS).row_bytes == 24
    assert count.read_text() == "x"
    trials.close()


def test_a_process_that_ended_for_want_of_work_is_replaced(tmp_path: Path) -> None:
    """A process that ends with status 0, even while it is asked, is started again. It is not the fault of a graph."""
    mark = tmp_path / "mark"
    code = (
        f"import os, sys; from pathlib import Path; mark = Path({str(mark)!r})\n"
        "if not mark.exists(): mark.touch(); input(); sys.exit(0)\n"
        "from service.model.trial_process import main; main()"
    )
    trials = Trials(["-c", code])
    assert trials.result(VALID, *TENSORS).row_bytes == 24
    trials.close()


@pytest.mark.parametrize(
    ("line", "kind", "message"),
    [
        ("os.kill(os.getpid(), signal.SIGXCPU)", BrokenModelError, "more processor time than is allowed"),
        ("os.abort()", BrokenModelError, "more memory than is allowed"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", BrokenModelError, "more memory than is allowed"),
        ("sys.exit(3)", BrokenModelError, "more memory than is allowed"),
        ("os.kill(os.getpid(), signal.SIGKILL)", BrokenModelError, "was killed"),
        ("os.kill(os.getpid(), signal.SIGTERM)", BrokenModelError, "was killed"),
        ("time.sleep(60)", BrokenModelError, "took more than 1 s"),
        ("sys.exit(1)", RegistryError, "cannot work: it ended with status 1"),
        ("sys.exit(0)", RegistryError, "cannot work: it ended with status 0"),
    ],
)
def test_a_process_that_ends_without_an_answer_is_an_error(line: str, kind: type[Exception], message: str) -> None:
    """Each way in which a process can end is an error of the tree that tells the reason, and leaves no process."""
    trials = Trials(script(line), patience_s=1.0)
    with pytest.raises(kind, match=message) as caught:
        trials.result(VALID, *TENSORS)
    assert type(caught.value) is kind


def test_a_process_that_cannot_be_started_is_an_error_of_the_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that starts no process refuses every graph, and names the reason. A graph is not at fault."""
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    with pytest.raises(RegistryError, match="no process to try it can be started: No such file") as caught:
        Trials().result(VALID, *TENSORS)
    assert type(caught.value) is RegistryError


def test_a_killed_trial_is_repeated_twice(tmp_path: Path) -> None:
    """A kill may be the fault of a busy machine, so the graph is tried again. After the third kill it is not."""
    count = tmp_path / "count"
    trials = Trials(script(f"open({str(count)!r}, 'a').write('x')", "os.kill(os.getpid(), signal.SIGKILL)"))
    for _ in range(5):
        with pytest.raises(BrokenModelError, match="was killed"):
            trials.result(VALID, *TENSORS)
    assert count.read_text() == "xxx"


def test_a_trial_process_knows_no_secret_and_writes_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of the process has no variable of the service or a bucket. Its limit of written bytes is 0."""
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    seen = tmp_path / "seen"
    code = (
        f"import os; open({str(seen)!r}, 'w').write(' '.join(os.environ));"
        "from service.model.trial_process import main; main()"
    )
    trials = Trials(["-c", code])
    trials.result(VALID, *TENSORS)
    assert "AWS" not in seen.read_text()
    process = trials._process
    assert process is not None
    assert resource.prlimit(process.pid, resource.RLIMIT_FSIZE) == (0, 0)
    assert resource.prlimit(process.pid, resource.RLIMIT_DATA)[0] < 600 << 20
    trials.close()


@pytest.mark.parametrize("kind", ["RLIMIT_CPU", "RLIMIT_DATA"])
def test_a_limit_that_the_operator_set_is_kept(kind: str) -> None:
    """Under a limit of the system, such as LimitDATA= of systemd, graphs are tried. The limit is never raised."""
    most = 1 << 40
    code = (
        f"import resource; resource.setrlimit(resource.{kind}, ({most}, {most}))\n"
        "def lower(kind, limits, real=resource.setrlimit):\n"
        "    hard = resource.getrlimit(kind)[1]\n"
        "    assert hard == -1 or -1 != limits[1] <= hard, 'only a privileged process may raise it'\n"
        "    real(kind, limits)\n"
        "resource.setrlimit = lower\n"
        "from service.model.trial_process import main; main()"
    )
    trials = Trials(["-c", code])
    assert trials.result(VALID, *TENSORS).row_bytes == 24
    process = trials._process
    assert process is not None
    soft, hard = resource.prlimit(process.pid, getattr(resource, kind))
    assert hard == most
    assert soft < 600 << 20
    trials.close()


def test_a_trial_process_ends_when_its_parent_does() -> None:
    """A process whose input is closed ends at once, so it does not outlive a parent that was killed."""
    trials = Trials()
    trials.result(VALID, *TENSORS)
    process = trials._process
    assert process is not None
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(10.0) == 0
    trials.close()


def test_a_forked_process_has_trials_of_its_own() -> None:
    """A process that was forked does not write into the pipe of its parent's trial process."""
    trials = Trials()
    trials.result(VALID, *TENSORS)
    child = os.fork()
    if child == 0:
        from service.model.trial import try_out

        os._exit(0 if try_out(VALID, *TENSORS).row_bytes == 24 else 1)
    deadline = time.monotonic() + 30.0
    while (status := os.waitpid(child, os.WNOHANG)) == (0, 0) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert status == (child, 0)
    trials.close()
