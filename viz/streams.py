"""Rerun's streams in a process that opens many: what is closed is let go, with its threads and memory.

Rerun keeps every stream that was ever opened until it is told to look for those that nobody holds, and the stream of
a blueprint for good, as it and its own memory hold each other: two threads and some megabytes each.
"""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings


def open_stream(application_id: str, batches: rr.ChunkBatcherConfig) -> rr.RecordingStream:
    """A new stream; earlier ones that nobody holds any more are let go."""
    rerun_bindings.flush_and_cleanup_orphaned_recordings()
    return rr.RecordingStream(application_id, batcher_config=batches)


def send_blueprint(stream: rr.RecordingStream, application_id: str, blueprint: rrb.Blueprint) -> None:
    """What `RecordingStream.send_blueprint` does, but the blueprint's own stream ends."""
    native = rerun_bindings.new_blueprint(
        application_id=application_id, make_default=False, make_thread_default=False, default_enabled=True
    )
    own = rr.RecordingStream._from_native(native)
    own.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(own)
    rerun_bindings.send_blueprint(own.memory_recording().storage, True, True, recording=stream.to_native())
    own.disconnect()
