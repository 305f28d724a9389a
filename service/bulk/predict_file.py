"""Prediction of a Parquet file of pushes into a new file, on any executor, in bounded memory."""

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow as pa

from service.bulk.chunk import ChunkPredictions, ModelParts, predict_chunk
from service.bulk.executors import Executor
from service.bulk.parquet_file import PredictionFile, PushFile, chunk_of
from service.storage.disk import new_file

Task = tuple[int, pa.RecordBatch]  # the number of its first row, and the columns that the model needs


def predict_file(
    source: PushFile, target: Path, model: ModelParts, executor: Executor, advance: Callable[[int], None]
) -> None:
    """Write every row of ``source`` with its prediction, in the same order, to a new file.

    ``advance`` is called with the number of rows of each finished task.

    Raises:
        DataError: columns are missing, the file is damaged, or ``target`` cannot be created.
        InvalidRequestError: a row is invalid. The error names the first one.
        WorkforceError: the workers cannot be started, or were lost.
    """
    columns = source.columns_for(model.manifest.context_kind)
    sent: deque[pa.RecordBatch] = deque()

    def tasks() -> Iterator[Task]:
        row = 0
        for batch in source.batches():
            sent.append(batch)
            yield row, batch.select(columns)
            row += batch.num_rows

    with (
        new_file(target) as opened,
        PredictionFile(opened, source.schema, model.manifest) as written,
        executor.start(chunk_predictor, model) as pool,
    ):
        for found in pool.in_order(tasks()):
            batch = sent.popleft()
            written.write(batch, found)
            advance(batch.num_rows)


def chunk_predictor(parts: ModelParts) -> Callable[[Task], ChunkPredictions]:
    """Load the model once per process and return the function that predicts a task."""
    model = parts.load()
    return lambda task: predict_chunk(model, chunk_of(*task))
