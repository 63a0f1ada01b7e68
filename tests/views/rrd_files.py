"""Reads a .rrd file back, with the SDK's own reader."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra `view`)")
chunk = pytest.importorskip("rerun.chunk", reason="this rerun-sdk reads no .rrd files back")


class Rrd:
    """What was logged, in order of time.

    name : the recording's name in the viewer's list.
    views : origin of a view in the layout -> its kind.
    spans : (start, end) in nanoseconds from the cursor, of each view that shows a part of the time.
    rows : entity -> [(microseconds, {"Archetype:component": value})], static ones at None.
    """

    def __init__(self, path: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what `rerun --save` writes has no footer
            reader = chunk.RrdReader(path)
        recordings = reader.recordings()
        assert len(recordings) == 1 and len(reader.blueprints()) == 1
        assert recordings[0].application_id == "async_tnt"
        self.rows: dict[str, list[tuple[int | None, dict[str, Any]]]] = {}
        for part in reader.stream():
            batch = part.to_record_batch()
            names = [field.name for field in batch.schema if ":" in field.name]
            times = [None] * batch.num_rows
            if "time" in batch.schema.names:
                times = [ns.value // 1000 for ns in batch.column("time")]
                assert all(ns.value % 1000 == 0 for ns in batch.column("time"))
            columns = [batch.column(name).to_pylist() for name in names]
            rows = self.rows.setdefault(part.entity_path.lstrip("/"), [])
            rows += [
                (t, dict(zip(names, values, strict=True)))
                for t, *values in zip(times, *columns, strict=True)
            ]
        about = self.rows.pop("__properties", [])
        names = [row["RecordingInfo:name"] for _, row in about if "RecordingInfo:name" in row]
        self.name: str | None = names[-1][0] if names else None
        self.views: dict[str, str] = {}
        self.spans: list[tuple[int, int]] = []
        for part in reader.stream(store=reader.blueprints()[0]):
            batch = part.to_record_batch()
            if "ViewBlueprint:space_origin" in batch.schema.names:
                kinds = batch.column("ViewBlueprint:class_identifier")
                origins = batch.column("ViewBlueprint:space_origin")
                self.views[origins[-1].as_py()[0].lstrip("/")] = kinds[-1].as_py()[0]
            if "VisibleTimeRanges:ranges" in batch.schema.names:
                for span in batch.column("VisibleTimeRanges:ranges")[-1].as_py():
                    self.spans.append((span["range"]["start"], span["range"]["end"]))
        for rows in self.rows.values():
            rows.sort(key=lambda row: -1 if row[0] is None else row[0])

    def times(self, entity: str) -> list[int]:
        return [t for t, _ in self.rows.get(entity, []) if t is not None]

    def series(self, entity: str, component: str) -> list[tuple[int, Any]]:
        """(microseconds, value) of a component that changes."""
        return [
            (t, row[component])
            for t, row in self.rows.get(entity, [])
            if t is not None and component in row
        ]

    def static(self, entity: str, component: str) -> Any:
        """The value of a component that was logged once, for all times."""
        (value,) = [
            row[component] for t, row in self.rows[entity] if t is None and component in row
        ]
        return value

    def images(self, entity: str, archetype: str = "Image") -> list[tuple[int, np.ndarray]]:
        """(microseconds, uint8 of shape (height, width) or (height, width, 3))."""
        found = []
        buffers = self.series(entity, f"{archetype}:buffer")
        formats = self.series(entity, f"{archetype}:format")
        for (t, (pixels,)), (_, (form,)) in zip(buffers, formats, strict=True):
            values = np.frombuffer(bytes(pixels), np.uint8)
            image = values.reshape(form["height"], form["width"], -1)
            found.append((t, image if image.shape[2] > 1 else image[:, :, 0]))
        return found
