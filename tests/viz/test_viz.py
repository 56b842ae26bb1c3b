"""The Rerun sink: what is written can be read back, number by number."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun.blueprint as rrb

from frontend.colours import CYCLE, track_colours
from tests.helpers.command import EVERY_FRAME, curve, seen_tracks
from tests.helpers.made_tracks import blank_tracks
from tests.helpers.moving_rectangle import CAMERA, RESET_FRAME, STEP_NS, frame_results, rectangle, trace_of
from tests.helpers.viewer import FRAMES, TRACKS, names_of_views, record
from viz.blueprint import layout
from viz.figures import COLOURS
from viz.stages import (
    coarse_descriptors,
    edge_image,
    line_angles,
    orientation_classes,
    orientation_image,
    orientation_palette,
    region_image,
    segment_colours,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("viz") / "run.rrd"


@pytest.fixture(scope="module")
def entities(path: Path) -> dict[str, dict[str, list]]:
    return record(path, descriptor_every=4)


def test_every_entity_has_one_row_per_frame_at_its_exact_time(entities):
    rows = {path: columns["frame"] for path, columns in entities.items() if "frame" in columns}
    assert rows.keys() >= EVERY_FRAME
    assert all(rows[path] == list(range(FRAMES)) for path in EVERY_FRAME)
    assert rows["/camera/descriptor"] == [0, 4, 8]
    assert rows["/log"] == [RESET_FRAME]
    assert entities["/log"]["TextLog:text"] == [["all tracks ended: the camera was covered"]]
    assert rows.keys() == EVERY_FRAME | {"/camera/descriptor", "/log"}
    for entity in EVERY_FRAME:
        assert entities[entity]["sensor_time"] == [k * STEP_NS for k in range(FRAMES)]


def test_epoch_stamps_become_timestamps(tmp_path):
    from rerun.chunk import RrdReader

    stamp = 1_700_000_000_123_456_789
    rows = record(tmp_path / "epoch.rrd", frame_results(2, first_stamp_ns=stamp))
    for path in ("/camera/tracks", "/stats/counts"):
        assert rows[path]["sensor_time"] == [stamp, stamp + STEP_NS]
        chunks = [c for c in RrdReader(tmp_path / "epoch.rrd").stream().to_chunks() if c.entity_path == path]
        batches = [b for b in (c.to_record_batch() for c in chunks) if "sensor_time" in b.schema.names]
        assert {str(batch.column("sensor_time").type) for batch in batches} == {"timestamp[ns]"}


@pytest.mark.parametrize("entity", ["/camera/segments", "/camera/tracks"])
def test_segments_are_moved_to_the_corner_convention_and_nothing_else(entities, entity):
    columns = seen_tracks(entities) if entity == "/camera/tracks" else entities[entity]
    for k, strips in enumerate(columns["LineStrips2D:strips"]):
        np.testing.assert_array_equal(np.array(strips, np.float32), rectangle(k) + np.float32(0.5))


def test_tracks_keep_their_id_and_their_colour_when_they_are_confirmed_too(entities):
    columns = seen_tracks(entities)
    assert columns["track_id"] == [[0, 1, 2, 3]] * FRAMES
    assert columns["LineStrips2D:colors"] == [columns["LineStrips2D:colors"][0]] * FRAMES
    assert entities["/camera/tracks"]["track_id"] == [[]] * 2 + [[0, 1]] * (FRAMES - 2)


def test_statistics(entities):
    assert curve(entities, "counts", "lines") == curve(entities, "counts", "tracks") == [4] * FRAMES
    assert curve(entities, "counts", "confirmed") == [0, 0] + [2] * (FRAMES - 2)
    assert curve(entities, "counts", "measured") == [0] * FRAMES
    assert curve(entities, "track_length", "median") == [0, 0, *range(2, FRAMES)]
    assert curve(entities, "time_ms", "edges") == [5.0 + k for k in range(FRAMES)]


def test_curves_have_colours_of_their_own():
    for names in (
        ("tracks", "confirmed", "lines", "measured", "lost"),
        ("edges", "pixels", "orientation", "grow", "fit", "refine", "track"),
    ):
        colours = np.array([COLOURS[name] for name in names])
        apart = np.linalg.norm(colours[:, None] - colours, axis=2)
        assert apart[~np.eye(len(names), dtype=bool)].min() > 70


def test_pinhole_has_the_corner_convention(entities):
    (matrix,) = entities["/camera"]["Pinhole:image_from_camera"][0]
    expected = CAMERA.matrix + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    np.testing.assert_allclose(np.reshape(matrix, (3, 3)).T, expected)


def test_pictures_decode_to_what_went_in(entities):
    last = list(frame_results(FRAMES))[-1]

    def picture(name: str) -> np.ndarray:
        blob = np.array(entities[f"/camera/{name}"]["EncodedImage:blob"][-1][0], np.uint8)
        return cv2.imdecode(blob, cv2.IMREAD_UNCHANGED).astype(int)

    assert np.abs(picture("image") - last.frame.image).mean() < 2
    assert np.abs(picture("edges") - edge_image(last.trace, 2)).mean() < 3


def test_the_recording_carries_the_layout(entities, path):
    plots = {"Lines per frame", "Track length (frames)", "Time per stage (ms)", "Log"}
    stages = {"Edges", "Orientation (hue: angle)", "Regions of lines", "Segments (hue: angle)"}
    assert names_of_views(path) == {TRACKS} | stages | plots


def test_wide_images_have_the_whole_width():
    """Else the tracks are beside the stages."""
    usual, wide = (layout("default", size).root_container.contents for size in ((640, 480), (1241, 376)))
    assert [len(row.contents) for row in usual] == [2, 4]
    assert isinstance(wide[0], rrb.Spatial2DView)
    assert len(wide) == 3


def test_orientations_are_numbers_with_colours_and_names(entities):
    rows = entities["/camera/orientation"]
    expected = orientation_classes(list(frame_results(FRAMES))[-1].trace, 2)
    (buffer,) = rows["SegmentationImage:buffer"][-1]
    np.testing.assert_array_equal(np.array(buffer, np.uint8).reshape(expected.shape), expected)
    (context,) = (row for row in rows["AnnotationContext:context"] if row)
    classes = {entry["class_id"]: entry["class_description"]["info"] for entry in context[0]}
    assert len(classes) == len(orientation_palette()) <= 256
    for number, (red, green, blue) in enumerate(orientation_palette().tolist()):
        assert classes[number]["color"] == red << 24 | green << 16 | blue << 8 | 255
    shown = {classes[number]["label"] for number in np.unique(expected[expected > 0]).tolist()}
    assert shown == {"0°, 75 % and more", "90°, 75 % and more"}  # of a rectangle


@pytest.mark.parametrize("image", [np.zeros((240, 320), np.uint8), np.zeros((240, 320, 3), np.uint16)])
def test_frame_without_lines_clears_what_was_shown(tmp_path, image):
    first, second = frame_results(2)
    blank = dataclasses.replace(
        second,
        frame=dataclasses.replace(second.frame, image=image),
        trace=trace_of(np.zeros((0, 2, 2), np.float32)),
        tracks=blank_tracks(0, frame_index=1, stamp_ns=STEP_NS, camera=CAMERA),
    )
    written = record(tmp_path / "run.rrd", [first, blank], descriptor_every=1)
    assert all(written[path]["frame"] == [0, 1] for path in EVERY_FRAME)
    assert written["/camera/tracks"]["LineStrips2D:strips"][1] == []
    assert written["/camera/segments"]["LineStrips2D:strips"][1] == []


def test_track_colours_are_stable_bright_and_far_apart():
    """Also where they come round."""
    ids = np.arange(CYCLE - 150, CYCLE + 150)
    colours = track_colours(ids)
    np.testing.assert_array_equal(track_colours(ids[::-1])[::-1], colours)
    assert (colours.max(axis=1) >= 250).all()
    assert (np.ptp(colours.astype(int), axis=1) > 100).all()  # no grey, no white
    neighbours = [np.linalg.norm(colours[k:].astype(int) - colours[: len(ids) - k], axis=1).min() for k in (1, 2, 3, 4)]
    assert min(neighbours) > 80


def test_coarse_descriptors_lose_no_cell_with_an_edge():
    trace = trace_of(rectangle(0))
    coarse = coarse_descriptors(trace)
    assert coarse.shape == (60, 80, 6)
    cells = np.zeros((60, 80), bool)
    cells[trace.pixels[:, 1] // 4, trace.pixels[:, 0] // 4] = True
    np.testing.assert_array_equal(coarse.any(axis=2), cells)


def test_regions_show_which_pixels_support_which_line():
    trace = trace_of(rectangle(0))
    labels = np.where(trace.descriptors[:, 0] > 0, 0, -1).astype(np.int32)  # all horizontal pixels, no others
    picture = region_image(dataclasses.replace(trace, labels=labels), np.array([700, 1, 2, 3], np.uint16), 2)
    assert set(np.unique(picture)) == {0, 700}
    x, y = trace.pixels[labels == 0].T // 2
    assert (picture[y, x] == 700).all()


def test_angles_average_across_the_wrap():
    descriptors = np.zeros((4, 6), np.float32)
    descriptors[0, 0] = descriptors[1, 3] = 1
    descriptors[2, [0, 5]] = np.sqrt(0.5)  # between 0 and 150 degrees lies 165, not 75
    descriptors[3, [1, 2]] = np.sqrt(0.5)
    np.testing.assert_allclose(np.degrees(line_angles(descriptors)), [0, 90, 165, 45], atol=1e-3)


def test_segments_have_the_hue_of_their_orientation():
    trace = trace_of(rectangle(0))
    picture = orientation_image(trace)
    for (x, y), colour in zip(
        np.rint(rectangle(0).mean(axis=1)).astype(int), segment_colours(rectangle(0)), strict=True
    ):
        assert picture[y, x].tolist() == colour.tolist()
    slanted = np.array([[[0, 0], [10, 10]], [[10, 10], [0, 0]], [[0, 10], [10, 0]]], np.float32)
    green, same, violet = segment_colours(slanted).tolist()
    assert green == same
    assert green[1] == violet[2] == 255


def test_orientation_image_shows_angle_as_hue_and_is_black_off_the_edges():
    trace = trace_of(rectangle(0))
    picture = orientation_image(trace)
    assert not picture[trace.edges == 0].any()
    (x0, y0), (x1, y1) = np.rint(rectangle(0)[:2].mean(axis=1)).astype(int)
    red, green, blue = picture[y0, x0].tolist()  # horizontal is red
    assert red == 255
    assert green == blue < 128
    red, green, blue = picture[y1, x1].tolist()  # vertical is the opposite, cyan
    assert red < 128
    assert green == blue == 255
