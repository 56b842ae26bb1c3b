"""Two runs side by side: matching lines, in matching colours, and the figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from frontend.colours import track_colours
from frontend.tracks import FIELDS, LineTracks
from logs.sinks.foxglove import McapTrackSink
from logs.sinks.tables import ParquetTrackSink
from tests.helpers.command import curve, recorded, refusal
from tests.helpers.made_tracks import clip_results, write_tracks
from viz.compare import main, match_lines

SHIFT_PX = 0.5


def moved(tracks: LineTracks) -> LineTracks:
    """Other ids, half a pixel to the side of each line, without every fifth line; every second was measured."""
    keep = np.arange(len(tracks)) % 5 != 0
    arrays = {field.name: getattr(tracks, field.name)[keep] for field in FIELDS if field.rows == "seen"}
    across = (arrays["segments_px"][:, 1] - arrays["segments_px"][:, 0])[:, ::-1] * (-1, 1)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    arrays["ids"] = arrays["ids"] + 1000
    arrays["segments_px"] = (arrays["segments_px"] + SHIFT_PX * across[:, None]).astype(np.float32)
    arrays["fragment_of"] = np.full(keep.sum(), -1)
    arrays["measured"] = arrays["ids"] % 2 > 0
    arrays["line_indices"] = np.where(arrays["measured"], -1, arrays["line_indices"]).astype(np.int32)
    return replace(tracks, **arrays)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    results = clip_results()
    write_tracks(McapTrackSink(folder / "a.mcap", with_images=True), results)
    later = [replace(r, tracks=replace(r.tracks, stamp_ns=r.tracks.stamp_ns + 10**15)) for r in results]
    runs = {"b": [replace(r, tracks=moved(r.tracks)) for r in results], "later": later, "half": results[1::2]}
    for name, run in {"a": results, **runs}.items():
        write_tracks(ParquetTrackSink(folder / f"{name}.parquet"), run)
    return folder


def compared(folder: Path, *arguments: object) -> dict[str, dict[str, list]]:
    assert main([*map(str, arguments), "--save", str(folder / "out.rrd")]) == 0
    return recorded(folder / "out.rrd")


def colours_by_line(columns: dict[str, list], row: int) -> dict[tuple[float, ...], int]:
    strips = np.array(columns["LineStrips2D:strips"][row], np.float32).reshape(-1, 4)
    return dict(zip(map(tuple, strips.tolist()), columns["LineStrips2D:colors"][row], strict=True))


def test_a_run_and_itself(files, tmp_path, capsys):
    entities = compared(tmp_path, files / "a.mcap", files / "a.parquet")
    a, b = entities["/a/tracks"], entities["/b/tracks"]
    assert a["frame"] == b["frame"] == [result.frame.index for result in clip_results()]
    for row, result in enumerate(clip_results()):
        assert a["track_id"][row] == b["track_id"][row] == result.tracks.ids.tolist()
        assert colours_by_line(a, row) == colours_by_line(b, row)
    assert all(not strips for side in "ab" for strips in entities[f"/{side}/unmatched"]["LineStrips2D:strips"])
    assert curve(entities, "distance", "median") == [0] * len(clip_results())
    assert capsys.readouterr().out.count("100.0 %") == 2
    assert len(entities["/camera/image"]["frame"]) == len(clip_results())  # those of the log


def test_matching_lines_have_matching_colours(files, tmp_path, capsys):
    entities = compared(tmp_path, files / "a.parquet", files / "b.parquet")
    a, b = entities["/a/tracks"], entities["/b/tracks"]
    same = total = 0
    for row, result in enumerate(clip_results()):
        colour_of_a = dict(zip(a["track_id"][row], a["LineStrips2D:colors"][row], strict=True))
        colour_of_b = dict(zip(b["track_id"][row], b["LineStrips2D:colors"][row], strict=True))
        same += sum(colour_of_a.get(track - 1000) == colour for track, colour in colour_of_b.items())
        total += len(colour_of_b)
        ids = np.array(list(colour_of_a), np.int64)
        expected = track_colours(ids).astype(np.uint32)
        rgb = np.array(list(colour_of_a.values()), np.uint32) >> 8
        np.testing.assert_array_equal(rgb, expected @ np.array([65536, 256, 1], np.uint32))
        unmatched = entities["/b/unmatched"]["track_id"][row]
        assert sorted([*colour_of_b, *unmatched]) == moved(result.tracks).ids.tolist()
    assert same > 0.95 * total
    assert f"{len(clip_results())} frames" in capsys.readouterr().out
    for name, least, most in (("B: b.parquet", 95, 100), ("A: a.parquet", 70, 85)):
        shares = curve(entities, "matched_share", name)
        assert least < min(shares) <= max(shares) <= most
    np.testing.assert_allclose(curve(entities, "distance", "median"), SHIFT_PX, atol=0.02)
    assert "/camera/image" not in entities


def test_frames_are_matched_by_their_stamps(files, tmp_path):
    entities = compared(tmp_path, files / "a.parquet", files / "half.parquet")
    assert entities["/a/tracks"]["frame"] == [k for k in range(len(clip_results())) if k % 2]


@pytest.mark.parametrize(
    ("a", "b", "save", "sentence"),
    [
        ("a.parquet", "later.parquet", "out.rrd", "have no frame in common"),
        ("a.parquet", "none.parquet", "out.rrd", "cannot read tracks"),
        ("a.parquet", "a.mcap", "out.txt", "ends with .rrd"),
    ],
)
def test_errors_are_one_sentence_and_leave_no_file(files, tmp_path, a, b, save, sentence):
    assert sentence in refusal(files / a, files / b, "--save", tmp_path / save, main=main)
    assert not (tmp_path / save).exists()


def test_lines_are_matched_one_to_one():
    first = np.array([[[10, 10], [90, 10]], [[10, 12], [90, 12]], [[10, 50], [90, 50]], [[5, 5], [5, 5]]], np.float32)
    second = np.array([[[90, 12.5], [10, 12.5]], [[50, 5], [50, 95]], [[12, 10], [80, 10.5]]], np.float32)
    rows, columns, distances = match_lines(first, second)
    assert dict(zip(rows.tolist(), columns.tolist(), strict=True)) == {0: 2, 1: 0}
    assert distances[1] == pytest.approx(0.5)
    assert all(len(part) == 0 for part in match_lines(first[:0], second))
    assert all(len(part) == 0 for part in match_lines(first * np.float32(np.nan), second))
