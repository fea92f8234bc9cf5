"""Records as messages of an MCAP file: scalars or arrays in JSON, with stamps as a real clock gives them."""

import json

import numpy as np
from mcap.writer import Writer

UNITS = {
    "displacement": [("m", 1.0), ("mm", 1e3), ("um", 1e6)],
    "velocity": [("m/s", 1.0), ("mm/s", 1e3), ("um/s", 1e6)],
    "acceleration": [("m/s2", 1.0), ("g", 1 / 9.80665)],
}
# Between the first samples of two records in a file [s].
APART_S = 4000
BEGIN_NS = 1_767_225_600_000_000_000


def messages(record, factor, start_ns, rng):
    """Stamps [ns] and contents of the messages of a record, in the order of sending."""
    scene, clock = record.scene, record.scene.clock
    size = clock.per_message or max(1, int(round(scene.fs_hz)))
    values = factor * record.samples
    begins = np.arange(0, len(values), size)
    stamps = begins / scene.fs_hz
    if clock.jitter_s > 0:
        stamps = stamps + clock.jitter_s * rng.standard_normal(len(stamps))
    if clock.late_s > 0:
        stamps[int(clock.late_at * (len(stamps) - 1))] += clock.late_s
    kept = np.ones(len(begins), dtype=bool)
    if clock.lost > 0:
        kept = rng.random_sample(len(begins)) >= clock.lost
    found = []
    for begin, stamp in zip(begins[kept], stamps[kept]):
        piece = [float(f"{value:.7g}") for value in values[begin : begin + size]]
        body = {"value": piece[0]} if clock.per_message == 1 else {"values": piece}
        found.append((start_ns + int(round(1e9 * stamp)), body))
    # A recorder writes in the order of its stamps.
    return sorted(found, key=lambda message: message[0])


def write(path, named, seed, unit=None):
    """Writes records, each on its own topic, one after the other. `named` holds (name, record, factor to its unit); the channels say
    the unit if there is one of all."""
    rng = np.random.RandomState(seed)
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("sample", "jsonschema", b'{"type":"object"}')
        for index, (name, record, factor) in enumerate(named):
            metadata = {"unit": unit} if unit else {}
            channel = writer.register_channel(topic=f"/{name}", message_encoding="json", schema_id=schema, metadata=metadata)
            start_ns = BEGIN_NS + index * APART_S * 1_000_000_000
            for stamp, body in messages(record, factor, start_ns, rng):
                data = json.dumps(body, separators=(",", ":")).encode()
                writer.add_message(channel_id=channel, log_time=stamp, publish_time=stamp, data=data)
        writer.finish()
