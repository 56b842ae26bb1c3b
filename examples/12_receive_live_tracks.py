"""Receive tracks from another process, live: `python examples/12_receive_live_tracks.py [ADDR]`.

ADDR is what `python -m frontend.run --publish ADDR` was given; without it such a run plays the built-in clip at a
camera's pace. Nothing of this project is imported, to show all that a receiver needs; `logs.subscribe_tracks` does the
same with checks. docs/protocol.md describes the fields.
"""

import subprocess
import sys
import time

import msgspec
import numpy as np
import zmq

FLAGS = ["--publish", "tcp://127.0.0.1:0", "--realtime", "--max-frames", "60", "--headless"]
publisher = None
if len(sys.argv) > 1:
    address = sys.argv[1]
else:
    publisher = subprocess.Popen([sys.executable, "-m", "frontend.run", *FLAGS], stdout=subprocess.PIPE, text=True)
    address = publisher.stdout.readline().split()[-1]  # publishing at tcp://127.0.0.1:43210

socket = zmq.Context.instance().socket(zmq.SUB)
socket.subscribe(b"")
socket.setsockopt(zmq.RCVTIMEO, 120_000)  # ms without any message
socket.connect(address)
print(f"waiting for tracks from {address}")
latencies, transports, lost, last = [], [], 0, None
try:
    while True:
        data = socket.recv()
        now_ns = time.time_ns()
        message = msgspec.msgpack.decode(data)  # a plain dict; any MessagePack library does
        if message["version"] != 1:
            sys.exit(f"the stream has version {message['version']} of the protocol")
        lost += 0 if last is None else message["sequence"] - last - 1
        last = message["sequence"]
        if message["type"] == "end":
            break
        arrays = {
            name: np.frombuffer(array["data"], array["dtype"]).reshape(array["shape"])
            for name, array in message["arrays"].items()
        }
        latencies.append((now_ns - message["read_ns"]) / 1e6)
        transports.append((now_ns - message["sent_ns"]) / 1e6)
        if last < 3 or last % 10 == 0:
            confirmed = arrays["states"] == 1
            # your backend's call goes here: message["stamp_ns"], arrays["ids"], arrays["segments_normalized"]
            print(f"frame {message['frame_index']}: {confirmed.sum()} confirmed tracks, {latencies[-1]:.1f} ms old")
except zmq.Again:
    sys.exit(f"nothing came from {address}")
finally:
    socket.close()
    if publisher is not None:
        publisher.terminate()
        publisher.communicate()
print(f"received {len(latencies)} frames, lost {lost}; all but the first, which waited until everything was ready:")
for name, values in {"from frame to message": latencies[1:], "of these, on the way": transports[1:]}.items():
    if values:
        print(f"{name}: median {np.median(values):.1f} ms, p99 {np.percentile(values, 99):.1f} ms")
