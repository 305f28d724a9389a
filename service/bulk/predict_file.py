"""From a Parquet file of pushes to one with their predictions, by any workforce, in bounded memory."""

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow as pa

from service.bulk.chunk import ModelParts, predict_chunk
from service.bulk.executors import Workforce
from service.bulk.parquet_file import PredictionFile, PushFile, chunk_of
from service.model.tensors import FloatArray
from service.storage.disk import new_file

Piece = tuple[int, pa.RecordBatch]  # the number of its first row, and the columns that the model wants


def predict_file(
    source: PushFile, target: Path, model: ModelParts, workforce: Workforce, advance: Callable[[int], None]
) -> None:
    """Write every row of ``source`` with its prediction, in its order, to a new file; ``advance`` hears of rows done.

    Raises:
        DataError: columns are missing, the file is damaged, or ``target`` cannot be a new file.
        InvalidRequestError: names the first row that cannot be.
        WorkforceError: there is nobody to do it.
    """
    columns = source.columns_for(model.manifest.context_kind)
    sent: deque[pa.RecordBatch] = deque()

    def pieces() -> Iterator[Piece]:
        row = 0
        for batch in source.batches():
            sent.append(batch)
            yield row, batch.select(columns)
            row += batch.num_rows

    with (
        new_file(target) as opened,
        PredictionFile(opened, source.schema, model.manifest) as written,
        workforce.at_work(chunk_predictor, model) as crew,
    ):
        for found in crew.in_order(pieces()):
            batch = sent.popleft()
            written.write(batch, found)
            advance(batch.num_rows)


def chunk_predictor(parts: ModelParts) -> Callable[[Piece], FloatArray]:
    """What a process does with each piece, once it has the model."""
    model = parts.load()
    return lambda piece: predict_chunk(model, chunk_of(*piece))
