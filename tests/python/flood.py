"""Floods a vehicle's keys with junk for some seconds, and prints how many messages that were and what CPU time they took here.

Usage: flood.py ENDPOINT VEHICLE SECONDS
"""
import json
import os
import resource
import sys
import time

import zenoh

endpoint, vehicle, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
paths = ["command/eve", "command", "answer", "topic/health", "topic/vehicle_state", "image/left", "view/obstacles", "anything"]
sent = 0
with zenoh.open(config) as session:
    until = time.time() + seconds
    while time.time() < until:
        for path in paths:
            session.put(f"sparrowhawk/{vehicle}/{path}", os.urandom(500))
            sent += 1
        time.sleep(0.002)
usage = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({"messages": sent, "cpu_s": round(usage.ru_utime + usage.ru_stime, 2)}))
