"""``cazsl predict --parquet``: millions of pushes of a file, on the local cores or on a Ray cluster."""

import sys
import time
from pathlib import Path

import click

from service.bulk.chunk import ModelParts
from service.bulk.executors import LocalThreads, RayCluster
from service.errors import DataError
from service.inference.snapshot import DEFAULT_MODELS
from service.model.reference import ModelReference
from service.registry.registry import Registry
from service.transport.threads import processors


def predict_parquet(
    source: Path, target: Path, reference: str | None, registry: Registry, jobs: int | None, ray_address: str | None
) -> None:
    """Predict every row of a Parquet file and say how fast that was.

    Raises:
        CazslError: the file, a row, the model, the target or the workforce cannot be; nothing was written.
    """
    try:  # a dependency that only tables need
        from service.bulk.parquet_file import PushFile
        from service.bulk.predict_file import predict_file
    except ImportError as error:
        raise DataError("--parquet needs the extra 'parquet': pip install 'cazsl[parquet]'") from error
    pushes = PushFile(source)
    model = _model(registry, reference or DEFAULT_MODELS[pushes.kind()])
    workforce = LocalThreads(jobs or processors()) if ray_address is None else RayCluster(ray_address)
    shown = sys.stderr
    began = time.perf_counter()
    with click.progressbar(length=pushes.rows, label=source.name, file=shown, hidden=not shown.isatty()) as bar:
        predict_file(pushes, target, model, workforce, bar.update)
    took_s = time.perf_counter() - began
    made_by = f"{model.manifest.name}@{model.manifest.version}"
    click.echo(
        f"{pushes.rows:,} pushes by {made_by} in {took_s:.1f} s: {pushes.rows / took_s:,.0f} rows/s, {workforce.words}"
    )
    click.echo(f"next: read {target}; mean_* and std_* are in m and rad, in the object's frame before the push")


def _model(registry: Registry, reference: str) -> ModelParts:
    """The version that a reference means, every byte verified."""
    parsed = ModelReference.parse(reference, "--model")
    verified = registry.read(parsed.name, registry.resolve(parsed))
    return ModelParts(verified.manifest, verified.model)
