"""A stranger on the ground, by Zenoh's Python client and the schema that the vehicle answers: reads states by field, commands a
goal, and waits until the vehicle is there. Prints what it saw as JSON.

Usage: command.py ENDPOINT VEHICLE X Y Z
"""
import json
import math
import sys
import time

import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

endpoint, vehicle, goal = sys.argv[1], sys.argv[2], [float(x) for x in sys.argv[3:6]]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
root = f"sparrowhawk/{vehicle}"

with zenoh.open(config) as session:
    replies = []
    deadline = time.time() + 20
    while not replies and time.time() < deadline:
        replies = [reply.ok.payload.to_bytes() for reply in session.get(f"{root}/schema", timeout=1.0) if reply.ok]
    files = descriptor_pb2.FileDescriptorSet.FromString(replies[0])
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    of = lambda name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"sparrowhawk.{name}"))
    VehicleState, Command, Answer, Health = map(of, ["VehicleState", "Command", "Answer", "Health"])
    states, answers, healthy = [], [], set()
    keep = [
        session.declare_subscriber(f"{root}/topic/vehicle_state", lambda s: states.append(VehicleState.FromString(s.payload.to_bytes()))),
        session.declare_subscriber(f"{root}/topic/answer", lambda s: answers.append(Answer.FromString(s.payload.to_bytes()))),
        session.declare_subscriber(f"{root}/topic/health", lambda s: healthy.add(Health.FromString(s.payload.to_bytes()).stamp.producer)),
    ]

    def wait(what, is_it, seconds):
        deadline = time.time() + seconds
        while not is_it():
            assert time.time() < deadline, f"never {what}; {len(states)} states, answers {answers}"
            time.sleep(0.05)

    wait("under way", lambda: len(states) > 10 and states[-1].position_m[2] > 1.0, 30)
    command = Command(number=1, order=2, operator="stranger", speed_mps=3.0)
    command.expires_ns = states[-1].stamp.valid_ns + 3_000_000_000
    command.elements.add().position_m.extend(goal)
    session.put(f"{root}/command/stranger", command.SerializeToString())
    wait("answered", lambda: any(answer.operator == "stranger" for answer in answers), 5)
    assert answers[-1].accepted == 1, answers[-1]
    wait("there", lambda: math.dist(states[-1].position_m, goal) < 1.0, 60)
    print(json.dumps({"states": len(states), "processes": len(healthy), "away_m": math.dist(states[-1].position_m, goal)}))
