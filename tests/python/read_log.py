"""Reads a log with Python's mcap: every channel has a schema, every message can be decoded by it, and none is missing that is
not noted as lost. Prints what it found as JSON.

Usage: read_log.py LOG.mcap
"""
import collections
import json
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    without_schema = [c.topic for c in summary.channels.values() if c.schema_id not in summary.schemas]
    counts = collections.Counter()
    first, last = {}, {}
    for _, channel, _, message in reader.iter_decoded_messages():
        counts[channel.topic] += 1
        if not channel.topic.startswith("/"):
            by = (channel.topic, message.stamp.producer, message.stamp.incarnation)
            first.setdefault(by, message.stamp.sequence)
            last[by] = message.stamp.sequence
    published = collections.Counter()
    for by, sequence in last.items():
        published[by[0]] += sequence - first[by] + 1
    noted = collections.Counter()
    for metadata in reader.iter_metadata():
        # Each note has all that was lost so far.
        for name, count in metadata.metadata.items():
            topic = name.removeprefix("lost ")
            noted[topic] = max(noted[topic], int(count))
    attached = [attachment.name for attachment in reader.iter_attachments()]

missing = {topic: published[topic] - counts[topic] for topic in published if published[topic] != counts[topic]}
assert not without_schema, without_schema
assert counts == {summary.channels[id].topic: n for id, n in summary.statistics.channel_message_counts.items() if n}
assert missing == {topic: n for topic, n in noted.items() if n}, (missing, noted)
print(json.dumps({"channels": len(summary.channels), "messages": sum(counts.values()), "missing": missing, "attached": attached}))
