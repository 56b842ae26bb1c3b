"""Tracks in MCAP: what the standard readers find in the file, and the same tracks read back."""

from __future__ import annotations

import json
from collections import defaultdict
from contextlib import closing
from dataclasses import replace

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from airline.errors import InputError
from frontend.colours import track_colours
from frontend.tracks import DERIVED, FIELDS
from logs.read import read_tracks
from logs.sinks.foxglove import RIGHT_TOPICS, McapTrackSink, message_for
from logs.sinks.output import McapOutput
from logs.tracks.json import SCHEMA, encode_tracks
from tests.helpers.made_tracks import CAMERA, FISHEYE, PAIR, clip_results, made_tracks, result_of, write_all

NO_ARRAYS = ("timestamp", "frame_index", "descriptor_length", "camera", "reset")
MADE = made_tracks(0, 0, np.arange(3), np.random.default_rng(0))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "tracks.mcap"
    with closing(McapTrackSink(path, with_images=True, labels=True)) as sink:
        for result in clip_results():
            sink.write(result)
    return path


@pytest.fixture(scope="module")
def messages(path):
    return decoded(path)


def decoded(path):
    """Messages by topic, as mcap's own strict reader and Foxglove's protobuf classes see them."""
    found = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            assert message.log_time == message.publish_time
            decoder = DecoderFactory().decoder_for(channel.message_encoding, schema)
            decoded = decoder(message.data) if decoder else json.loads(message.data)
            found[channel.topic].append((message.log_time, schema.name, decoded))
    return found


def test_topics_and_times(messages):
    assert {topic: entries[0][1] for topic, entries in messages.items()} == {
        "/lines/annotations": "foxglove.ImageAnnotations",
        "/lines/tracks": "frontend.LineTracks",
        "/camera/calibration": "foxglove.CameraCalibration",
        "/camera/image": "foxglove.CompressedImage",
    }
    stamps = [result.frame.stamp_ns for result in clip_results()]
    for topic in ("/lines/annotations", "/lines/tracks", "/camera/image"):
        assert [stamp for stamp, _, _ in messages[topic]] == stamps
    for topic in ("/lines/annotations", "/camera/image", "/camera/calibration"):
        for stamp, _, message in messages[topic]:
            assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == stamp
    for stamp, _, message in messages["/lines/tracks"]:
        assert message["timestamp"]["sec"] * 10**9 + message["timestamp"]["nsec"] == stamp


def test_annotations_lie_on_the_lines_in_the_colours_of_the_ids(messages):
    for (_, _, message), result in zip(messages["/lines/annotations"], clip_results(), strict=True):
        tracks = result.tracks
        (lines,) = message.points
        assert lines.type == lines.LINE_LIST
        assert lines.thickness > 0
        points = np.array([(p.x, p.y) for p in lines.points]).reshape(-1, 2, 2)
        np.testing.assert_allclose(points - 0.5, tracks.segments_px, atol=1e-9)
        colours = np.array([(c.r, c.g, c.b, c.a) for c in lines.outline_colors])
        expected = track_colours(tracks.ids)
        np.testing.assert_allclose(colours[:, :3] * 255, expected, atol=1e-6)
        assert (colours[tracks.confirmed, 3] == 1).all()
        assert (colours[~tracks.confirmed, 3] < 0.6).all()
        assert [text.text for text in message.texts] == [str(i) for i in tracks.ids[tracks.confirmed]]
        middles = tracks.segments_px[tracks.confirmed].mean(1) + 0.5
        places = np.array([(t.position.x, t.position.y) for t in message.texts]).reshape(-1, 2)
        np.testing.assert_allclose(places, middles, atol=1e-4)
    assert len(messages["/lines/annotations"][-1][2].texts) > 20


def test_points_are_drawn_where_there_are_any(tmp_path):
    made = [made_tracks(k, k, np.arange(3), np.random.default_rng(0), points=count) for k, count in enumerate([0, 5])]
    without, tracks = made
    assert len(message_of(without).points) == 1
    dots = message_of(tracks).points[1]
    assert dots.type == dots.POINTS
    np.testing.assert_allclose([(p.x - 0.5, p.y - 0.5) for p in dots.points], tracks.points_px, atol=1e-9)
    colours = np.array([(c.r, c.g, c.b) for c in dots.outline_colors]) * 255
    np.testing.assert_allclose(colours, track_colours(tracks.point_ids), atol=1e-6)


def message_of(tracks):
    return ImageAnnotations.FromString(message_for("/lines/annotations", result_of(tracks), labels=False))


def test_images_and_calibration(messages):
    for (_, _, message), result in zip(messages["/camera/image"], clip_results(), strict=True):
        assert message.format == "jpeg"
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image.shape == result.frame.image.shape
        assert np.abs(image.astype(int) - result.frame.image).mean() < 4
    camera = clip_results()[0].frame.camera
    ((_, _, message),) = messages["/camera/calibration"]
    assert (message.width, message.height) == (camera.width, camera.height)
    np.testing.assert_array_equal(np.reshape(message.K, (3, 3)), camera.matrix)
    np.testing.assert_array_equal(np.reshape(message.P, (3, 4))[:, :3], camera.matrix)
    assert (message.distortion_model, list(message.D)) == ("plumb_bob", [0.0] * 5)


def test_calibration_comes_again_with_time_and_with_another_camera(tmp_path):
    rng = np.random.default_rng(0)
    cameras = [CAMERA] * 3 + [FISHEYE] * 2 + [None] + [replace(FISHEYE)] * 2
    made = (made_tracks(k, k * 400_000_000, np.arange(3), rng, camera=camera) for k, camera in enumerate(cameras))
    write_all(McapTrackSink(tmp_path / "t.mcap"), made)
    with (tmp_path / "t.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [
            (message.log_time // 400_000_000, decoded.distortion_model, list(decoded.D))
            for _, _, message, decoded in reader.iter_decoded_messages(topics=["/camera/calibration"])
        ]
    plumb_bob, fisheye = [*CAMERA.coefficients, 0.0], list(FISHEYE.coefficients)
    assert found == [(0, "plumb_bob", plumb_bob), (3, "kannala_brandt", fisheye), (6, "kannala_brandt", fisheye)]


def test_the_file_states_its_conventions(path):
    with path.open("rb") as file:
        (record,) = make_reader(file).iter_metadata()
    assert record.name == "airline-frontend"
    assert "(0, 0)" in record.metadata["pixels"]
    assert record.metadata["schema version"] == "1"
    assert record.metadata["topic of tracks"] == "/lines/tracks"


def test_the_schema_in_the_file_describes_the_messages(path, messages):
    jsonschema = pytest.importorskip("jsonschema")
    with path.open("rb") as file:
        schemas = {schema.name: schema for schema in make_reader(file).get_summary().schemas.values()}
    assert schemas["frontend.LineTracks"].encoding == "jsonschema"
    schema = json.loads(schemas["frontend.LineTracks"].data)
    assert schema["title"] == "frontend.LineTracks"
    described = schema["properties"] | {name.strip("^$"): one for name, one in schema["patternProperties"].items()}
    assert all(field["description"] for field in described.values())
    assert described.keys() == {*NO_ARRAYS, *(field.name for field in (*FIELDS, *DERIVED))}
    odd = made_tracks(0, 0, np.arange(2), np.random.default_rng(0), lost=1, camera=None, reset="x", length=1)
    odd.scores[0] = np.nan
    for message in (*(message for _, _, message in messages["/lines/tracks"]), json.loads(encode_tracks(odd))):
        jsonschema.validate(message, schema)
        assert message.keys() == set(schema["required"]) == described.keys()
    for name, wrong in {"segments_px": [[[0, 0]]], "scores": "1", "camera": {"width": 1}, "ids": [0.5]}.items():
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**json.loads(encode_tracks(odd)), name: wrong}, schema)


def test_messages_have_every_number_of_every_field(messages):
    for (_, _, message), result in zip(messages["/lines/tracks"], clip_results(), strict=True):
        for field in (*FIELDS, *DERIVED):
            expected = getattr(result.tracks, field.name)
            if expected is None:
                assert (message[field.name], field.rows) == (None, "right")
                continue
            found = np.array(message[field.name], field.dtype).reshape(expected.shape)
            np.testing.assert_array_equal(found, expected, field.name)


def test_a_right_image_has_topics_of_its_own(tmp_path):
    """The partners, the rectified camera that sees them there, and the lines in metres, which it projects onto them."""
    rng, image = np.random.default_rng(0), np.full((240, 320), 77, np.uint8)
    mono = made_tracks(0, 0, np.arange(3), rng, camera=PAIR)
    tracks = made_tracks(1, 2 * 10**9, np.arange(60), rng, camera=PAIR, right=True)
    with closing(McapTrackSink(tmp_path / "t.mcap", with_images=True)) as sink:
        sink.write(result_of(mono))
        result = result_of(tracks)
        sink.write(replace(result, frame=replace(result.frame, right=image)))
    found = decoded(tmp_path / "t.mcap")
    assert {len(found[topic]) for topic in RIGHT_TOPICS} == {1}
    assert len(found["/camera/image"]) == 2
    ((_, _, lines),) = found["/lines/right/annotations"]
    partners = np.array([(p.x, p.y) for p in lines.points[0].points]).reshape(-1, 2, 2) - 0.5
    np.testing.assert_allclose(partners, tracks.right_px[tracks.right_hits > 0], atol=1e-4)
    ((_, _, picture),) = found["/camera/right/image"]
    assert (cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_GRAYSCALE) == 77).all()
    ((_, _, camera),) = found["/camera/right/calibration"]
    ((_, _, update),) = found["/lines/depth"]
    (entity,) = update.entities
    assert entity.frame_id == found["/camera/image"][0][2].frame_id
    points = np.array([(p.x, p.y, p.z, 1) for p in entity.lines[0].points])
    assert len(points) == 2 * tracks.depth_known.sum() > 10
    projected = points @ np.reshape(camera.P, (3, 4)).T
    assert (tracks.right_hits[tracks.depth_known] > 0).all()
    np.testing.assert_allclose(
        projected[:, :2] / projected[:, 2:], tracks.right_px[tracks.depth_known].reshape(-1, 2), atol=1e-3
    )


def test_players_know_the_types_of_the_schema():
    """Foxglove Studio and Lichtblick refuse a topic whose schema has a property of other types than these."""
    for name, schema in SCHEMA["properties"].items():
        assert schema["type"] in ("boolean", "string", "number", "integer", "object", "array"), name
        if schema["type"] == "array":
            assert schema["items"]["type"] in ("boolean", "string", "number", "integer"), name
        elif schema["type"] == "object":
            assert {one["type"] for one in schema["properties"].values()} == {"integer"}, name


def test_sequence_numbers_count_on_each_topic(path):
    found = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found[channel.topic].append(message.sequence)
    assert len(found) == 4
    for topic, numbers in found.items():
        assert numbers == list(range(1, len(numbers) + 1)), topic


def test_times_before_the_epoch_are_refused(tmp_path):
    with pytest.raises(InputError, match="before the epoch"):
        write_all(McapTrackSink(tmp_path / "t.mcap"), [made_tracks(0, -1, np.arange(3), np.random.default_rng(0))])


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"ids": [1, 2]}, "different lengths"),
        ({"ids": [1, 2, 2**63]}, "ids"),
        ({"states": [0, 1, 7]}, "unknown state"),
        ({"scores": [0, 1, 1e39]}, "scores"),
        ({"segments_px": [[[0, 0], [0, 0]]] * 2 + [[[0, 0], [0]]]}, "segments_px"),
        ({"descriptor_length": 2**40}, "descriptor_length"),
        ({"timestamp": {"sec": 0, "nsec": 10**9}}, "nsec"),
        ({"timestamp": {"sec": 9223372036, "nsec": 999999999}}, "out of range"),
        ({"camera": {"width": 1}}, "camera"),
        ({"camera": {**json.loads(encode_tracks(MADE))["camera"], "fx": -1.0}}, "focal"),
        ({"reset": 3}, "reset"),
    ],
)
def test_messages_of_others_are_refused_in_one_sentence(tmp_path, change, complaint):
    output = McapOutput(path := tmp_path / "t.mcap", False, {})
    channel = output.channel("/t", "json", "frontend.LineTracks", "jsonschema", b"")
    output.write(channel, 5, json.dumps({**json.loads(encode_tracks(MADE)), **change}).encode())
    output.close()
    with pytest.raises(InputError, match=complaint) as error:
        list(read_tracks(path))
    assert "\n" not in str(error.value)


def test_other_files_are_refused(tmp_path):
    for name, text in {"a.mcap": b"no", "b.mcap": b"", "c.txt": b"x"}.items():
        (tmp_path / name).write_bytes(text)
        with pytest.raises(InputError, match=name):
            list(read_tracks(tmp_path / name))
    with pytest.raises(InputError, match="No such file"):
        read_tracks(tmp_path / "missing.mcap")


def test_poses_and_lines_in_space(tmp_path):
    turn = cv2.Rodrigues(np.array([0.1, -0.4, 0.2]))[0]
    poses = [np.eye(4), np.block([[turn, np.array([[1.0], [2.0], [3.0]])], [np.zeros((1, 3)), np.ones((1, 1))]])]
    segments, ids = np.arange(12, dtype=np.float32).reshape(2, 2, 3), np.array([3, 4])
    results = clip_results()[:2]
    with closing(McapTrackSink(tmp_path / "t.mcap")) as sink:
        with pytest.raises(InputError, match="write one first"):
            sink.log_pose(poses[0])
        for result, pose in zip(results, poses, strict=True):
            sink.write(result)
            sink.log_pose(pose)
            sink.log_lines_3d(segments, ids)
        with pytest.raises(InputError, match="a pose must be"):
            sink.log_pose(2 * np.eye(4))
        with pytest.raises(InputError, match="lines in space must be"):
            sink.log_lines_3d(segments, ids[:1])
    found = defaultdict(list)
    with (tmp_path / "t.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=["/tf", "/lines/space"]):
            found[channel.topic, schema.name].append((message.log_time, decoded))
    stamps = [result.tracks.stamp_ns for result in results]
    for (at, tf), stamp, pose in zip(found["/tf", "foxglove.FrameTransform"], stamps, poses, strict=True):
        assert (at, tf.parent_frame_id, tf.child_frame_id) == (stamp, "world", "camera")
        assert [tf.translation.x, tf.translation.y, tf.translation.z] == pose[:3, 3].tolist()
        x, y, z, w = tf.rotation.x, tf.rotation.y, tf.rotation.z, tf.rotation.w
        assert np.isclose(np.linalg.norm([x, y, z, w]), 1)
        across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        np.testing.assert_allclose(np.eye(3) + 2 * w * across + 2 * across @ across, pose[:3, :3], atol=1e-9)
    for (at, update), stamp in zip(found["/lines/space", "foxglove.SceneUpdate"], stamps, strict=True):
        (entity,) = update.entities
        (lines,) = entity.lines
        assert (at, entity.frame_id, lines.type) == (stamp, "world", lines.LINE_LIST)
        np.testing.assert_array_equal(np.float32([(p.x, p.y, p.z) for p in lines.points]).reshape(2, 2, 3), segments)
        colours = np.array([(c.r, c.g, c.b) for c in lines.colors]) * 255
        np.testing.assert_allclose(colours, track_colours(ids).repeat(2, axis=0), atol=1e-9)
        assert lines.pose.orientation.w == 1
