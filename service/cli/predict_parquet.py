"""``cazsl predict --parquet``: predict a file of millions of pushes, on this machine or on a Ray cluster."""

import sys
import time
from pathlib import Path

import click

from service.bulk.chunk import ModelParts
from service.bulk.executors import RayExecutor, ThreadExecutor
from service.cli.configuration import configure
from service.cli.terminal import echo, printable
from service.errors import DataError
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.processors import processors
from service.registry.registry import Registry


def predict_parquet(
    source: Path, target: Path, reference: str | None, registry: Registry, jobs: int | None, ray_address: str | None
) -> None:
    """Predict every row of a Parquet file and print the speed.

    Raises:
        CazslError: the file, a row, the model, the target or the executor cannot be used. No file was written.
    """
    try:  # an optional dependency
        from service.bulk.parquet_file import PushFile
        from service.bulk.predict_file import predict_file
    except ImportError as error:
        raise DataError("--parquet needs the extra 'parquet': pip install 'cazsl[parquet]'") from error
    pushes = PushFile(source)
    model = _model(registry, reference or default_model(pushes.kind()))
    executor = ThreadExecutor(jobs or processors()) if ray_address is None else RayExecutor(ray_address)
    terminal = sys.stderr
    start_s = time.perf_counter()
    with click.progressbar(
        length=pushes.rows, label=printable(source.name), file=terminal, hidden=not terminal.isatty()
    ) as bar:
        predict_file(pushes, target, model, executor, bar.update)
    elapsed_s = time.perf_counter() - start_s
    speed = f"{pushes.rows / elapsed_s:,.0f} rows/s, {executor.description}"
    name = f"{model.manifest.name}@{model.manifest.version}"
    echo(f"{pushes.rows:,} pushes by {name} in {elapsed_s:.1f} s: {speed}")
    echo(f"next: read {target}; mean_* and std_* are in m and rad, in the object's frame before the push")


def default_model(kind: ContextKind) -> str:
    """Return the name of the model that answers for a kind of context, by the settings.

    Raises:
        SettingsError: a setting is unknown or invalid.
    """
    return configure({}).settings.default_models()[kind]


def _model(registry: Registry, reference: str) -> ModelParts:
    """Read and verify the version that a reference names."""
    parsed = ModelReference.parse(reference, "--model")
    verified = registry.read(parsed.name, registry.resolve(parsed))
    return ModelParts(verified.manifest, verified.model)
