"""What goes into a recording, by its settings: images, layout, how often, states of tracks, space, the log."""

from __future__ import annotations

import dataclasses
import io
import json
import logging
import time
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from frontend.colours import CYCLE, track_colours
from tests.helpers.command import command, curve, recorded, refusal, seen_tracks
from tests.helpers.made_tracks import blank_tracks, clip_results
from tests.helpers.moving_rectangle import HEIGHT, RESET_FRAME, STEP_NS, WIDTH, frame_results, rectangle, trace_of
from tests.helpers.videos import encode, number_in, trim
from tests.helpers.viewer import FRAMES, TRACKS, contents_of_views, names_of_views, record
from viz.lines import BOLD_LINES, SHOWN_LINES, TAIL_LENGTH, Tails
from viz.overlay import write_film
from viz.rerun_sink import RerunSink

STAGES = {f"/camera/{name}" for name in ("edges", "orientation", "regions", "segments")}


def write_video(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Path:
    """The moving rectangle as a video, 30 frames/s."""
    write_film(path, [cv2.resize(result.frame.image, size) for result in frame_results(FRAMES)], 30)
    return path


def test_raw_images_come_back_as_they_were(tmp_path):
    rows = record(tmp_path / "run.rrd", image="raw")
    for k, result in enumerate(frame_results(FRAMES)):
        pixels = np.array(rows["/camera/image"]["Image:buffer"][k][0], np.uint8)
        np.testing.assert_array_equal(pixels.reshape(HEIGHT, WIDTH, 3), result.frame.image)


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv"])
def test_video_is_logged_once_and_referred_to_by_time(tmp_path, name):
    rows = record(tmp_path / "run.rrd", image="video", video=write_video(tmp_path / name))
    images = rows["/camera/image"]
    (blob,) = (row for row in images["AssetVideo:blob"] if row)
    times = [row[0] for row in images["VideoFrameReference:timestamp"]]
    assert len(blob[0]) > 1000
    assert times == sorted(set(times))
    np.testing.assert_allclose(np.array(times) - times[0], STEP_NS * np.arange(FRAMES), atol=1_000_000)
    assert not rows.keys() & STAGES
    assert rows["/camera/tracks"]["frame"] == list(range(FRAMES))
    figures = {"Lines per frame", "Track length (frames)", "Time per stage (ms)"}
    assert names_of_views(tmp_path / "run.rrd") == {TRACKS, "Log"} | figures


def test_video_with_a_header_that_rerun_cannot_read_is_mended(tmp_path):
    """Some cameras' files hold more than the sequence parameters where those should be."""
    import rerun as rr

    odd = tmp_path / "odd.mp4"
    with av.open(str(write_video(tmp_path / "clip.mp4"))) as source, av.open(str(odd), "w") as target:
        read = source.streams.video[0]
        written = target.add_stream_from_template(read)
        header = bytes(read.codec_context.extradata)
        length = int.from_bytes(header[6:8], "big")
        longer = (length + 40).to_bytes(2, "big") + header[8 : 8 + length] + bytes([0x65] * 40)
        written.codec_context.extradata = header[:6] + longer + header[8 + length :]
        for packet in source.demux(read):
            if packet.dts is not None:
                packet.stream = written
                target.mux(packet)
    with pytest.raises(RuntimeError):
        rr.AssetVideo(path=odd).read_frame_timestamps_nanos()
    rows = record(tmp_path / "run.rrd", image="video", video=odd)
    assert len({row[0] for row in rows["/camera/image"]["VideoFrameReference:timestamp"] if row}) == FRAMES


@pytest.mark.parametrize(
    ("spec", "says"),
    [("missing.mp4", "needs a video file"), ("text.mp4", "no video that Rerun can play"), ("old.avi", "mpeg4")],
)
def test_videos_that_cannot_be_shown_are_refused(tmp_path, spec, says):
    (tmp_path / "text.mp4").write_text("no video")
    old = cv2.VideoWriter(str(tmp_path / "old.avi"), cv2.VideoWriter.fourcc(*"MP4V"), 30, (64, 48))
    old.write(np.zeros((48, 64, 3), np.uint8))
    old.release()
    with pytest.raises(ConfigError, match=f"{says}.*use --log-image jpeg"):
        RerunSink(save=tmp_path / "run.rrd", image="video", video=tmp_path / spec)


def test_video_cannot_stand_for_frames_of_another_size(tmp_path):
    video = write_video(tmp_path / "clip.mp4", size=(160, 120))
    with pytest.raises(ConfigError, match="another size"):  # as soon as the thread behind `write` has told
        record(tmp_path / "run.rrd", image="video", video=video)


@pytest.mark.parametrize("flags", [["--resize", "160"], ["--undistort"]])
def test_video_and_changed_frames_exclude_each_other(tmp_path, flags):
    path = write_video(tmp_path / "clip.mp4")
    error = refusal(path, "--log-image", "video", "--save", tmp_path / "run.rrd", *flags)
    assert "leave --resize and --undistort out" in error
    assert not (tmp_path / "run.rrd").exists()


def test_every_fourth_frame_and_all_resets(tmp_path):
    rows = record(tmp_path / "run.rrd", every=4, descriptor_every=8)
    for path in ("/camera/image", "/camera/tracks", "/stats/counts", *STAGES):
        assert rows[path]["frame"] == [0, 4, 8]
    assert rows["/camera/descriptor"]["frame"] == [0, 8]
    assert rows["/log"]["frame"] == [RESET_FRAME]


def test_states_differ_to_the_eye_and_carry_the_numbers(tmp_path):
    """Ids 0 and 1 are confirmed, 2 and 3 tentative, 1 and 3 pieces of another line; 7 is lost."""
    result = list(frame_results(5))[-1]
    more = {"lost_ids": np.array([7]), "lost_segments_px": rectangle(9)[:1], "lost_frames": np.array([1])}
    tracks = dataclasses.replace(result.tracks, fragment_of=np.array([-1, 0, -1, 0]), **more)
    rows = record(tmp_path / "run.rrd", [dataclasses.replace(result, tracks=tracks)])
    seen, rest, lost = (rows[f"/camera/tracks{name}"] for name in ("", "/rest", "/lost"))

    def colours(columns: dict[str, list]) -> np.ndarray:
        return np.array(columns["LineStrips2D:colors"][0], ">u4").view("u1").reshape(-1, 4)[:, :3].astype(int)

    (whole, piece), (young, young_piece) = colours(seen), colours(rest)
    bold, (thin,), (faint,) = (columns["LineStrips2D:radii"][0] for columns in (seen, rest, lost))
    assert bold[0] == bold[1] > thin > faint > 0
    assert whole.max() == young.max() == 255
    assert max(piece.max(), young_piece.max()) < 160
    np.testing.assert_array_equal(young, track_colours(np.array([2]))[0])
    assert np.ptp(colours(lost)) < 60, "lost ones are grey"
    assert lost["track_id"] == [[7]]
    np.testing.assert_array_equal(np.float32(lost["LineStrips2D:strips"][0]), rectangle(9)[:1] + np.float32(0.5))
    assert curve(rows, "counts", "lost") == [1]


def test_points_are_logged_once_there_are_any(tmp_path):
    assert "/camera/points" not in record(tmp_path / "off.rrd")
    none, some, gone = frame_results(3)
    points = {"point_ids": np.array([3, 8]), "points_px": np.float32([[0, 1.5], [20, 7]])}
    results = [none, dataclasses.replace(some, tracks=dataclasses.replace(some.tracks, **points)), gone]
    rows = record(tmp_path / "on.rrd", results)["/camera/points"]
    assert rows["frame"] == [1, 2]
    assert rows["point_id"] == [[3, 8], []]
    np.testing.assert_array_equal(np.float32(rows["Points2D:positions"][0]), points["points_px"] + np.float32(0.5))
    assert rows["Points2D:positions"][1] == []


@pytest.mark.parametrize(("flags", "shown"), [({}, [5, 7]), ({"show_lost": True}, [5, 6, 7, 8])])
def test_lost_lines_are_drawn_for_three_frames_unless_asked_for(tmp_path, flags, shown):
    (result,) = frame_results(1)
    frames = np.array([1, 4, 3, 30], np.int32)
    more = {"lost_ids": np.arange(5, 9), "lost_segments_px": rectangle(9), "lost_frames": frames}
    rows = record(
        tmp_path / "run.rrd", [dataclasses.replace(result, tracks=dataclasses.replace(result.tracks, **more))], **flags
    )
    lost = rows["/camera/tracks/lost"]
    assert lost["track_id"] == [shown]
    drawn = np.float32(lost["LineStrips2D:strips"][0])
    np.testing.assert_array_equal(drawn, rectangle(9)[np.isin(more["lost_ids"], shown)] + np.float32(0.5))
    assert curve(rows, "counts", "lost") == [4], "the figures count all"


def test_tracks_that_were_measured_say_so_and_have_no_region(tmp_path):
    """Also in a frame in which no line was detected."""
    first, second = frame_results(2)
    measured = np.array([False, True, False, True])
    some = dataclasses.replace(first.tracks, measured=measured, line_indices=np.array([3, -1, 0, -1], np.int32))
    none = dataclasses.replace(second.tracks, measured=np.ones(4, bool), line_indices=np.full(4, -1, np.int32))
    blank = dataclasses.replace(second, trace=trace_of(rectangle(1)[:0]), tracks=none)
    labelled = dataclasses.replace(first.trace, labels=np.arange(len(first.trace.pixels)).astype(np.int32) % 4)
    rows = record(tmp_path / "run.rrd", [dataclasses.replace(first, trace=labelled, tracks=some), blank])
    assert seen_tracks(rows)["measured"] == [measured.tolist(), [True] * 4]
    assert seen_tracks(rows)["track_id"] == [[0, 1, 2, 3]] * 2
    assert curve(rows, "counts", "measured") == [2, 4]
    classes = [
        np.array(row[0], np.uint8).view(np.uint16) for row in rows["/camera/regions"]["SegmentationImage:buffer"] if row
    ]
    assert [set(picture[1:].tolist()) for picture in classes] == [{0, 1, 3}, {0}]


def test_tails_lead_from_the_lines_to_where_they_were(tmp_path):
    tails = record(tmp_path / "run.rrd")["/camera/tails"]["LineStrips2D:strips"]
    assert [len(row) for row in tails] == [0, 0] + [2] * (FRAMES - 2)  # two lines are confirmed from the third frame on
    longest = TAIL_LENGTH * np.sqrt(WIDTH * HEIGHT)
    for k in range(2, FRAMES):
        for tail, middle in zip(tails[k], rectangle(k)[:2].mean(axis=1) + 0.5, strict=True):
            way = np.array([3, 2]) * min(k, longest / np.hypot(3, 2))  # the rectangle's motion is (3, 2) px per frame
            np.testing.assert_allclose([tail[0], tail[-1]], [middle, middle - way], atol=0.3)


@pytest.mark.parametrize("shorter", [200, 120])
def test_tails_do_not_follow_ends_that_come_and_go(shorter):
    tails = Tails()
    for k in range(12):
        start, end = (20, 200) if k // 3 % 2 else (50, shorter)
        line = np.array([[[start, 50 + k], [end, 50 + k]]], np.float32)
        tracks = blank_tracks(1, segments_px=line)
        _, points, _ = tails.add(tracks, tracks.ids, 100)
    middle = (start + end) / 2
    np.testing.assert_allclose(points, [(middle, 61), (middle, 59), (middle, 56), (middle, 53), (middle, 50)], atol=0.3)


def test_at_most_so_many_lines_are_bold_or_shown_and_all_are_there(tmp_path):
    """Many lines; the view leaves out what is in `rest`, and those who are bold stay so."""
    count, generator = 600, np.random.default_rng(1)
    start = generator.uniform(10, 200, (count, 1, 2))
    lines = np.concatenate([start, start + generator.uniform(5, 60, (count, 1, 2))], axis=1).astype(np.float32)
    result = list(frame_results(5))[-1]
    many = blank_tracks(count, frame_index=4, segments_px=lines, states=np.ones(count, np.uint8), ages=np.arange(count))
    many = dataclasses.replace(many, hits=many.ages + 1, stable=np.ones(count, bool))
    rows = record(tmp_path / "run.rrd", [dataclasses.replace(result, tracks=many)])
    shown = rows["/camera/tracks"]
    radii = np.array(shown["LineStrips2D:radii"][0])
    assert len(shown["track_id"][0]) == SHOWN_LINES
    bold = np.array(shown["track_id"][0])[radii == radii.max()]
    assert len(bold) == BOLD_LINES
    length = np.hypot(*(lines[:, 1] - lines[:, 0]).T)
    assert length[bold].mean() > 1.1 * length.mean()
    assert seen_tracks(rows)["track_id"] == [list(range(count))]


@pytest.mark.parametrize("kind", ["minimal", "default", "full"])
def test_ghosts_and_tentative_lines_are_shown_when_asked_for(tmp_path, kind):
    record(tmp_path / "run.rrd", blueprint=kind)
    contents = contents_of_views(tmp_path / "run.rrd")
    (tracks,) = (paths for name, paths in contents.items() if "racks (" in name)
    shown = {f"/camera/{name}" for name in ("image", "tracks", "tails", "points", "tracks/rest", "tracks/lost")}
    assert tracks == shown if kind == "full" else tracks == shown - {"/camera/tracks/rest", "/camera/tracks/lost"}


def test_regions_are_in_the_colours_of_their_tracks(tmp_path):
    rows = record(tmp_path / "run.rrd")["/camera/regions"]
    (context,) = (row for row in rows["AnnotationContext:context"] if row)
    colours = {entry["class_id"]: entry["class_description"]["info"]["color"] for entry in context[0]}
    ids = np.array([0, 1, 77, CYCLE - 1])
    for track, (red, green, blue) in zip(ids.tolist(), track_colours(ids).tolist(), strict=True):
        assert colours[1 + track] == red << 24 | green << 16 | blue << 8 | 255


def test_poses_and_lines_in_space(tmp_path):
    sink = RerunSink(save=tmp_path / "run.rrd")
    poses = []
    for k, result in enumerate(frame_results(4)):
        sink.write(result)
        poses.append(np.eye(4))
        poses[-1][:3, 3] = [k, 0, 2 * k]
        sink.log_pose(poses[-1])
        sink.log_lines_3d(np.full((4, 2, 3), k, np.float32), result.tracks.ids)
    sink.close()
    rows = recorded(tmp_path / "run.rrd")
    assert [row[0] for row in rows["/camera"]["Transform3D:translation"] if row] == [[k, 0, 2 * k] for k in range(4)]
    assert rows["/world/lines"]["frame"] == [0, 1, 2, 3]
    assert rows["/world/lines"]["track_id"] == [[0, 1, 2, 3]] * 4
    assert rows["/world/lines"]["sensor_time"] == [k * STEP_NS for k in range(4)]
    assert rows["/world/path"]["LineStrips3D:strips"][3] == [[[2, 0, 4], [3, 0, 6]]]
    assert "Space" in names_of_views(tmp_path / "run.rrd")


def test_things_that_are_not_in_space_are_refused(tmp_path):
    sink = RerunSink(save=tmp_path / "run.rrd")
    for pose in (np.eye(3), 2 * np.eye(4), np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match="pose must be"):
            sink.log_pose(pose)
    with pytest.raises(InputError, match="lines in space"):
        sink.log_lines_3d(np.zeros((2, 2, 2)), np.arange(2))
    sink.close()


def test_warnings_of_our_packages_are_in_the_log_at_their_frame(tmp_path):
    sink = RerunSink(save=tmp_path / "run.rrd")
    logging.getLogger("frontend.sources").warning("before the first frame")
    for result in frame_results(3):
        sink.write(result)
        logging.getLogger("logs.source").info("not worth it")
        logging.getLogger("somebody.else").warning("not ours")
        if result.frame.index == 1:
            logging.getLogger("frontend.sources.video").error("frame %d is damaged", 1)
    sink.close()
    logging.getLogger("frontend").warning("after the end")
    log = recorded(tmp_path / "run.rrd")["/log"]
    assert log["TextLog:text"] == [["before the first frame"], ["frame 1 is damaged"]]
    assert log["TextLog:level"] == [["WARN"], ["ERROR"]]
    assert log["frame"] == [0, 1]


def test_a_disk_that_is_almost_full_is_said_and_the_file_is_whole(tmp_path, monkeypatch):
    sink = RerunSink(save=tmp_path / "run.rrd")
    first, second = frame_results(2)
    sink.write(first)
    monkeypatch.setattr("viz.destination.SPARE", 2**60)

    def go_on() -> None:
        for _ in range(100):  # the disk is looked at every second
            sink.write(second)
            time.sleep(0.1)

    with pytest.raises(InputError, match=r"cannot write more of the recording .*MB are free: is the disk full"):
        go_on()
    with pytest.raises(InputError, match="is the disk full"):
        sink.close()
    assert recorded(tmp_path / "run.rrd")["/camera/tracks"]["frame"][0] == first.frame.index


def test_recordings_of_the_clip_keep_to_their_size(tmp_path):
    """80 kB per frame of 320x240, 20 with a video: over few frames, in which what comes once weighs most."""
    results = clip_results()
    write_film(tmp_path / "clip.mp4", [result.frame.image for result in results], 30)
    for mode, limit in (("jpeg", 80_000), ("video", 20_000)):
        record(tmp_path / f"{mode}.rrd", results, image=mode, video=tmp_path / "clip.mp4")
        assert (tmp_path / f"{mode}.rrd").stat().st_size < limit * len(results)


def test_settings_reach_the_recording(clip, tmp_path):
    path = tmp_path / "run.rrd"
    flags = ("--log-image", "none", "--log-every", 2, "--log-descriptor-every", 0, "--blueprint", "minimal")
    assert command(clip, "--save", path, *flags).code == 0
    rows = recorded(path)
    assert rows["/camera/tracks"]["frame"] == [0, 2, 4, 6]
    assert not {"/camera/image", "/camera/descriptor"} & rows.keys()
    assert rows.keys() > STAGES | {"/camera/tracks", "/camera/tails"}
    assert names_of_views(path) == {TRACKS, "Lines per frame", "Log"}
    sizes = {}
    for quality in (95, 10):
        assert command(clip, "--save", path, "--jpeg-quality", quality).code == 0
        for name in ("image", "edges"):
            ((blob,), *_) = recorded(path)[f"/camera/{name}"]["EncodedImage:blob"]
            sizes[name, quality] = len(blob)
    assert sizes["image", 95] > 3 * sizes["image", 10]
    assert sizes["edges", 95] > 2 * sizes["edges", 10]


def test_a_trimmed_video_shows_the_right_pictures(tmp_path):
    """Rerun shows what an edit list hides, FFmpeg does not."""
    whole = encode(tmp_path / "whole.mp4", bf="2", g="40")
    clip = trim(whole, tmp_path / "clip.mp4", 600)
    path = tmp_path / "run.rrd"
    assert command(clip, "--log-image", "video", "--save", path).code == 0
    images = recorded(path)["/camera/image"]
    times = [row[0] for row in images["VideoFrameReference:timestamp"] if row]
    assert times == [600_000_000 + 40_000_000 * k for k in range(25)], "of all pictures"
    (blob,) = (np.uint8(row[0]).tobytes() for row in images["AssetVideo:blob"] if row)
    with av.open(io.BytesIO(blob)) as file:
        shown = {round(frame.time * 1e9): number_in(frame.to_ndarray(format="bgr24")) for frame in file.decode(video=0)}
    assert [shown[time] for time in times] == list(range(15, 40))


@pytest.mark.parametrize("name", ["clip.ts", "clip.avi"])
def test_videos_that_fit_into_no_mp4_are_refused(tmp_path, name):
    with pytest.raises(ConfigError, match=f"Rerun cannot play .*{name}: use --log-image jpeg"):
        RerunSink(save=tmp_path / "run.rrd", image="video", video=encode(tmp_path / name, bf="2"))


def test_what_is_no_file_cannot_be_logged_as_a_video(tmp_path):
    (tmp_path / "folder").mkdir()
    for spec in ("http://me:secret@127.0.0.1:9/clip.mp4", "/dev/video97", tmp_path / "folder"):
        said = refusal(spec, "--log-image", "video", "--save", tmp_path / "run.rrd")
        assert "--log-image video needs a video file as its input" in said
        assert "secret" not in said


def test_a_turned_video_is_recorded_as_jpegs(tmp_path):
    """Rerun does not turn videos, and lines are to lie on the image."""
    clip = encode(tmp_path / "clip.mp4", count=5, rotation=(180, False, False))
    path, figures = tmp_path / "run.rrd", tmp_path / "run.json"
    done = command(clip, "--log-image", "video", "--save", path, "--summary", figures)
    assert done.code == 0
    note = "Rerun does not turn videos, so the recording has the frames as JPEGs"
    assert f"note: {note}" in done.out
    assert note in json.loads(figures.read_text())["notes"]
    blobs = recorded(path)["/camera/image"]["EncodedImage:blob"]
    pictures = [cv2.imdecode(np.uint8(blob[0]), cv2.IMREAD_COLOR) for blob in blobs]
    assert [number_in(np.rot90(picture, 2)) for picture in pictures] == list(range(5))
    assert command(clip, "--log-image", "video", "--no-autorotate", "--save", path, "--overwrite").code == 0
    assert any(recorded(path)["/camera/image"]["AssetVideo:blob"])
