"""Tests of bulk prediction: whole files, row order, equal bytes on every executor, and the row of an error."""

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner, Result

from service.bulk.chunk import CHUNK_ROWS, NUMBER_COLUMNS, PREDICTED_COLUMNS, ModelParts
from service.bulk.executors import Executor, ProcessExecutor, SerialExecutor, ThreadExecutor
from service.bulk.parquet_file import PushFile
from service.bulk.predict_file import predict_file
from service.cli.main import main
from service.client import Client
from service.model.tensors import ContextKind
from service.registry.registry import Registry
from service.schemas.contexts import ContextBody
from tests.ray_cluster import NodeLossExecutor, TwoNodes

ROWS = 9 * CHUNK_ROWS + 17
OBJECTS = np.array([f"{a}a{b}b4c1a" for a in "1234" for b in "1234"])


def table(rows: int, **columns: Any) -> pa.Table:
    """Make a table of random pushes of 16 objects. A keyword replaces a column, or drops it if it is None."""
    rng = np.random.default_rng(7)
    found = {
        "number": np.arange(rows),
        "x_m": rng.uniform(-0.1, 0.1, rows),
        "y_m": rng.uniform(-0.1, 0.1, rows),
        "angle_rad": rng.uniform(-9.0, 9.0, rows),
        "descriptor": OBJECTS[rng.integers(len(OBJECTS), size=rows)],
        **columns,
    }
    return pa.table({name: column for name, column in found.items() if column is not None})


def with_value(name: str, row: int, value: object) -> pa.Table:
    """Make a table of pushes with one value replaced."""
    column = table(100)[name].to_pylist()
    column[row] = value
    return table(100, **{name: pa.array(column)})


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of ten chunks, of which the last one is shorter."""
    path = tmp_path_factory.mktemp("source") / "pushes.parquet"
    pq.write_table(table(ROWS), path, row_group_size=1000)
    return path


@pytest.fixture(scope="module")
def model(project_root: Path) -> ModelParts:
    """The shipped model for descriptors."""
    verified = Registry(project_root / "models").read("push-indicator", 3)
    return ModelParts(verified.manifest, verified.model)


@pytest.fixture(scope="module")
def expected(source: Path, model: ModelParts) -> bytes:
    """The file that one process writes."""
    return written(source, source.with_name("expected.parquet"), model, SerialExecutor())


def written(source: Path, target: Path, model: ModelParts, executor: Executor) -> bytes:
    """Predict a file and return the bytes of the result."""
    done: list[int] = []
    pushes = PushFile(source)
    predict_file(pushes, target, model, executor, done.append)
    assert sum(done) == pushes.rows
    return target.read_bytes()


def predict(source: pa.Table | Path, target: Path, registry: Path, *options: str) -> Result:
    """Run the command on a file, or on a table that is written to a file first."""
    if isinstance(source, pa.Table):
        path = target.with_name("in.parquet")
        pq.write_table(source, path)
        source = path
    arguments = ["predict", "--parquet", str(source), str(target), "--jobs", "1", "--registry", str(registry), *options]
    return CliRunner().invoke(main, arguments)


@pytest.fixture
def registry(project_root: Path) -> Path:
    """The shipped registry."""
    return project_root / "models"


def test_rows_keep_their_order_and_get_what_the_service_answers(
    source: Path, expected: bytes, project_root: Path
) -> None:
    """Every column and the order of rows are kept, and predictions equal those of a request up to rounding."""
    found, given = pq.read_table(pa.BufferReader(expected)), pq.read_table(source)
    assert found.select(given.schema.names).equals(given)
    rows = slice(CHUNK_ROWS - 50, CHUNK_ROWS + 50)
    few = given.slice(rows.start, 100)
    with Client.local(str(project_root / "models")) as client:
        answer = client.predict_batch(
            np.column_stack([few[name] for name in ("x_m", "y_m", "angle_rad")]), few["descriptor"].to_pylist()
        )
    predicted = np.column_stack([found[name].to_numpy()[rows] for name in NUMBER_COLUMNS])
    np.testing.assert_allclose(predicted, np.hstack([answer.mean, answer.std]), rtol=1e-4, atol=1e-6)


def test_file_metadata_name_the_model(expected: bytes) -> None:
    """The metadata of the file hold the model, its version and the frame of the poses."""
    metadata = pq.read_schema(pa.BufferReader(expected)).metadata
    assert {key: metadata[key.encode()] for key in ("cazsl.model", "cazsl.version", "cazsl.frame")} == {
        "cazsl.model": b"push-indicator",
        "cazsl.version": b"3",
        "cazsl.frame": b"object",
    }


@pytest.mark.parametrize("executor", [ThreadExecutor(3), ProcessExecutor(2)], ids=["threads", "processes"])
def test_several_workers_write_the_same_bytes(
    source: Path, expected: bytes, model: ModelParts, tmp_path: Path, executor: Executor
) -> None:
    """Several workers write the same bytes as one."""
    assert written(source, tmp_path / "out.parquet", model, executor) == expected


def test_a_cluster_that_loses_a_node_writes_the_same_bytes(
    source: Path, expected: bytes, model: ModelParts, two_nodes: TwoNodes, tmp_path: Path
) -> None:
    """A cluster that loses one of its two nodes while both predict writes the same bytes."""
    executor = NodeLossExecutor(two_nodes, tmp_path, held=5)
    assert written(source, tmp_path / "out.parquet", model, executor) == expected
    assert executor.run_twice() == 1


def test_the_command_uses_the_cluster_that_it_is_given(
    source: Path, expected: bytes, ray_cluster: TwoNodes, tmp_path: Path, registry: Path
) -> None:
    """The command with --ray writes the same bytes and prints the address of the cluster."""
    target = tmp_path / "out.parquet"
    arguments = ["predict", "--parquet", str(source), str(target), "--ray", ray_cluster.address]
    result = CliRunner().invoke(main, [*arguments, "--registry", str(registry)])
    assert result.exit_code == 0, result.output
    assert f"Ray at {ray_cluster.address}" in result.stdout
    assert target.read_bytes() == expected


def test_command_prints_its_speed_and_the_next_step(tmp_path: Path, registry: Path) -> None:
    """The command prints rows, model, rows per second and the path of the result."""
    result = predict(table(100), tmp_path / "out.parquet", registry)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("100 pushes by push-indicator@3 in ")
    assert " rows/s, 1 job\nnext: read " in result.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.parquet", "out.parquet"]


@pytest.mark.parametrize(
    ("columns", "options", "by"),
    [
        ({"descriptor": None}, (), "push-none@2"),
        ({"descriptor": pa.array(["1a2b3c4a"] * 5).dictionary_encode()}, (), "push-indicator@3"),
        ({"descriptor": None, "visual": [bytes(1024)] * 5}, (), "push-visual@2"),
        ({"descriptor": None, "visual": pa.array([bytes(1024)] * 5, pa.binary(1024))}, (), "push-visual@2"),
        ({"visual": [bytes(1024)] * 5}, ("--model", "push-visual"), "push-visual@2"),
        ({"x_m": np.zeros(5, dtype=np.float32), "y_m": np.zeros(5, dtype=int)}, (), "push-indicator@3"),
        ({}, ("--model", "push-indicator@1"), "push-indicator@1"),
        ({}, ("--model", "push-none"), "push-none@2"),
    ],
    ids=["no object", "categories", "views", "views of fixed size", "both", "other numbers", "version", "ignored"],
)
def test_model_is_chosen_by_the_columns_or_the_option(
    columns: dict[str, Any], options: tuple[str, ...], by: str, tmp_path: Path, registry: Path
) -> None:
    """The champion for the context column predicts, unless --model names another."""
    result = predict(table(5, **columns), tmp_path / "out.parquet", registry, *options)
    assert result.exit_code == 0, result.output
    assert f"5 pushes by {by} in " in result.stdout
    assert pq.read_table(tmp_path / "out.parquet").num_rows == 5


def test_file_without_rows_gives_a_file_without_rows(tmp_path: Path, registry: Path) -> None:
    """A file without rows is predicted to a file without rows that has all columns."""
    result = predict(table(5).slice(0, 0), tmp_path / "out.parquet", registry)
    assert result.exit_code == 0, result.output
    assert pq.read_schema(tmp_path / "out.parquet").names[-7:] == [*PREDICTED_COLUMNS]


@pytest.mark.parametrize(
    ("pushes", "message"),
    [
        (
            with_value("x_m", 17, float("nan")),
            "row 17 (counted from 0), column x_m: received nan; accepted is a finite",
        ),
        (
            with_value("angle_rad", 3, float("-inf")),
            "row 3 (counted from 0), column angle_rad: received -inf; accepted",
        ),
        (
            with_value("y_m", 99, None),
            "row 99 (counted from 0), column y_m: received an empty cell; accepted is a finite",
        ),
        (with_value("y_m", 5, 1.5), "row 5 (counted from 0), column y_m: received 1.5 m; accepted is -1 to 1 m"),
        (with_value("descriptor", 8, "1a2b"), "row 8 (counted from 0), column descriptor: received 4 characters"),
        (with_value("descriptor", 8, "1a2b3c5a"), "column descriptor side 4: received an unknown shape; accepted is"),
        (
            with_value("descriptor", 8, None),
            "row 8 (counted from 0), column descriptor: received an empty cell; accepted is",
        ),
        (table(5, descriptor=None, visual=[b"short"] * 5), "row 0 (counted from 0), column visual: received 5 bytes"),
        (
            table(5, x_m=None),
            "received 0 columns x_m among number, y_m, angle_rad, descriptor; accepted is a column of",
        ),
        (table(5, x_m=["a"] * 5), "column x_m: received string; accepted is a column of numbers"),
        (table(5, descriptor=[1] * 5), "column descriptor: received int64; accepted is a column of text"),
        (
            table(5, visual=[b""] * 5),
            "received columns descriptor and visual; accepted is one of them, or a model named",
        ),
        (table(5, std_x_m=[1.0] * 5), "received column std_x_m; accepted is a table without it"),
    ],
    ids=str,
)
def test_invalid_row_or_column_is_named(pushes: pa.Table, message: str, tmp_path: Path, registry: Path) -> None:
    """An invalid row or column is one line with its place, the value and the accepted ones, and no file is written."""
    result = predict(pushes, tmp_path / "out.parquet", registry)
    assert result.exit_code == 1
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["in.parquet"]


def test_first_of_several_invalid_rows_is_named(source: Path, model: ModelParts, tmp_path: Path) -> None:
    """The error names the first invalid row, whichever process finds one first."""
    pushes = pq.read_table(source).to_pydict()
    for row in (3 * CHUNK_ROWS + 5, 3 * CHUNK_ROWS + 6, 4 * CHUNK_ROWS):
        pushes["x_m"][row] = 2.0
    pq.write_table(pa.table(pushes), tmp_path / "in.parquet")
    with pytest.raises(Exception, match=f"^row {3 * CHUNK_ROWS + 5} "):
        written(tmp_path / "in.parquet", tmp_path / "out.parquet", model, ProcessExecutor(2))
    assert [path.name for path in tmp_path.iterdir()] == ["in.parquet"]


def test_existing_file_is_never_overwritten(tmp_path: Path, registry: Path) -> None:
    """An existing file under the name of the result is an error, and keeps its content."""
    (tmp_path / "out.parquet").write_text("mine", encoding="utf-8")
    result = predict(table(5), tmp_path / "out.parquet", registry)
    assert result.exit_code == 1
    assert "received a name that is taken; accepted is a new one" in result.stderr
    assert (tmp_path / "out.parquet").read_text(encoding="utf-8") == "mine"


def test_unreadable_source_or_target_is_one_line(tmp_path: Path, registry: Path) -> None:
    """A source that is not a Parquet file, or a missing folder of the result, is an error of one line."""
    (tmp_path / "text").write_text("x_m,y_m", encoding="utf-8")
    for source in (tmp_path / "text", tmp_path / "gone"):
        result = predict(source, tmp_path / "out.parquet", registry)
        assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1)
        assert "accepted is a Parquet file" in result.stderr
    folder = predict(tmp_path, tmp_path / "out.parquet", registry)
    assert (folder.exit_code, len(folder.stderr.splitlines()), "a folder, not a file" in folder.stderr) == (2, 1, True)
    pq.write_table(table(5), tmp_path / "in.parquet")
    lost = predict(tmp_path / "in.parquet", tmp_path / "gone" / "out.parquet", registry)
    assert (lost.exit_code, "cannot be written" in lost.stderr) == (1, True)


@pytest.mark.parametrize(
    "arguments",
    [["0", "0"], ["--jobs", "2", "--", "0", "0", "0"], ["--ray", "auto", "1a2b3c4a", "0", "0", "0"], ["a", "b", "c"]],
    ids=["too few", "jobs", "ray", "no numbers"],
)
def test_options_for_files_need_a_file(arguments: list[str]) -> None:
    """Options for files without --parquet, and wrong arguments, exit with status 2."""
    assert CliRunner().invoke(main, ["predict", *arguments]).exit_code == 2


def test_context_kind_is_found_by_its_column(source: Path) -> None:
    """A descriptor column means an indicator context."""
    assert PushFile(source).kind() is ContextKind.INDICATOR


def test_missing_extra_is_one_line(tmp_path: Path, registry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing extra is an error of one line that says how to install it."""
    monkeypatch.setitem(sys.modules, "ray", None)
    target = tmp_path / "out.parquet"
    pq.write_table(table(5), tmp_path / "in.parquet")
    arguments = ["predict", "--parquet", str(tmp_path / "in.parquet"), str(target), "--registry", str(registry)]
    without_ray = CliRunner().invoke(main, [*arguments, "--ray", "auto"])
    assert without_ray.stderr == "Error: --ray needs the extra 'ray': pip install 'cazsl[ray]'\n"
    monkeypatch.setitem(sys.modules, "service.bulk.predict_file", None)
    without_pyarrow = CliRunner().invoke(main, arguments)
    assert without_pyarrow.stderr == "Error: --parquet needs the extra 'parquet': pip install 'cazsl[parquet]'\n"
    assert not target.exists()


BOX = '{"outline": [[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]]}'
L = '{"outline": [[-0.05, -0.05], [0.05, -0.05], [0.05, -0.02], [-0.02, -0.02], [-0.02, 0.05], [-0.05, 0.05]]}'


def shapes(**columns: Any) -> pa.Table:
    """Make a table of pushes of two outlines with lengths. A keyword replaces a column, or drops it if it is None."""
    found = {
        "x_m": [-0.1, -0.1, -0.1],
        "y_m": [0.0, 0.01, 0.0],
        "angle_rad": [0.0, 0.1, 0.0],
        "length_m": [0.05, 0.1, 0.02],
        "context": [BOX, L, BOX],
        **columns,
    }
    return pa.table({name: column for name, column in found.items() if column is not None})


@pytest.fixture(scope="module")
def with_shapes(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """A registry of a model of shapes and one of descriptors."""
    root = tmp_path_factory.mktemp("registry") / "models"
    shutil.copytree(project_root / "models", root)
    return root


def test_shapes_are_predicted_with_their_lengths(with_shapes: Path, tmp_path: Path) -> None:
    """A column of contexts in JSON is predicted by the model of shapes, as the client predicts the same pushes."""
    result = predict(shapes(), tmp_path / "out.parquet", with_shapes)
    assert result.exit_code == 0, result.output
    found = pq.read_table(tmp_path / "out.parquet")
    assert found.schema.metadata[b"cazsl.model"] == b"push-shape"
    given = shapes()
    with Client.local(str(with_shapes)) as client:
        contexts = [ContextBody.model_validate_json(text) for text in given["context"].to_pylist()]
        poses = np.column_stack([given[name] for name in ("x_m", "y_m", "angle_rad")])
        answer = client.predict_batch(poses, contexts, lengths=given["length_m"].to_numpy())
    predicted = np.column_stack([found[name].to_numpy() for name in NUMBER_COLUMNS])
    np.testing.assert_allclose(predicted, np.hstack([answer.mean, answer.std]), rtol=1e-4, atol=1e-6)


def test_lengths_may_be_left_out(with_shapes: Path, tmp_path: Path) -> None:
    """Without a column of lengths every push is one of 50 mm."""
    tables = shapes(length_m=None), shapes(length_m=[0.05] * 3)
    for number, table in enumerate(tables):
        assert predict(table, tmp_path / f"{number}.parquet", with_shapes).exit_code == 0
    first, second = (pq.read_table(tmp_path / f"{number}.parquet") for number in range(2))
    assert first.select(PREDICTED_COLUMNS).equals(second.select(PREDICTED_COLUMNS))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"context": [BOX, "{", BOX]}, "row 1 (counted from 0), column context: received a text that is no context"),
        ({"context": [BOX, '{"outline": [[0, 0], [1, 1]]}', BOX]}, "row 1 (counted from 0), column context.outline"),
        ({"context": [BOX, '{"descriptor": "1a2b3c4a"}', BOX]}, "column context: received a context of kind indicator"),
        ({"context": [BOX, L, None]}, "row 2 (counted from 0), column context: received an empty cell"),
        ({"context": [1, 2, 3]}, "column context: received int64"),
        ({"length_m": [0.05, 0.0, 0.05]}, "row 1 (counted from 0), column length_m: received 0 m"),
        ({"length_m": [0.05, None, 0.05]}, "row 1 (counted from 0), column length_m: received an empty cell"),
        ({"length_m": ["a", "b", "c"]}, "column length_m: received string"),
        ({"x_m": [-0.1, -0.1, 0.01]}, "row 2 (counted from 0), column x_m: received a pusher that starts inside"),
        ({"x_m": [-0.1, 11.0, -0.1]}, "row 1 (counted from 0), column x_m: received 11 m"),
        ({"context": None, "descriptor": ["1a2b3c4a"] * 3}, "row 1 (counted from 0), column length_m: received 0.1 m"),
        ({"descriptor": ["1a2b3c4a"] * 3}, "received columns descriptor and context"),
    ],
)
def test_an_invalid_shape_or_length_names_its_row(
    with_shapes: Path, tmp_path: Path, columns: dict[str, Any], message: str
) -> None:
    """The first invalid row is named with its column, and no file is written."""
    result = predict(shapes(**columns), tmp_path / "out.parquet", with_shapes)
    assert result.exit_code == 1
    assert message in result.output
    assert not (tmp_path / "out.parquet").exists()


def test_warnings_are_a_column(tmp_path: Path, registry: Path) -> None:
    """Each row has its codes with spaces between them, or an empty text."""
    pushes = table(3, x_m=[-0.08, -0.5, -0.08], y_m=[0.0] * 3, angle_rad=[0.0, 0.0, -180.0])
    assert predict(pushes, tmp_path / "out.parquet", registry).exit_code == 0
    found = pq.read_table(tmp_path / "out.parquet")["warnings"].to_pylist()
    assert found[0] == ""
    assert found[1].split() == ["no_contact", "unfamiliar_push"]
    assert "angle_looks_like_degrees" in found[2].split()
