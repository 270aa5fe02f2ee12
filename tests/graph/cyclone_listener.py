"""A Cyclone DDS participant that takes one image off a ROS topic: `python cyclone_listener.py TOPIC`.

Prints "ready" when a writer is matched, then one line of JSON. Knows nothing of ROS but its mapping to DDS: topics
begin with `rt/`, types stand in `<package>::msg::dds_::` and end in `_`.
"""

import hashlib
import json
import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


def main() -> None:
    name = f"rt{sys.argv[1]}"
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=10)), Policy.History.KeepLast(10))
    reader = DataReader(Subscriber(participant), Topic(participant, name, Image), qos=qos)
    deadline = time.monotonic() + 60.0
    while not reader.get_matched_publications():
        if time.monotonic() > deadline:
            sys.exit(f"no writer of {name} was found")
        time.sleep(0.05)
    print("ready", flush=True)
    while time.monotonic() < deadline:
        for image in reader.take(10):
            if not isinstance(image, Image):
                continue
            print(
                json.dumps(
                    {
                        "stamp_ns": image.header.stamp.sec * 10**9 + image.header.stamp.nanosec,
                        "size": [image.height, image.width],
                        "encoding": image.encoding,
                        "step": image.step,
                        "frame_id": image.header.frame_id,
                        "sha256": hashlib.sha256(bytes(image.data)).hexdigest(),
                    }
                )
            )
            return
        time.sleep(0.02)
    sys.exit(f"no image came on {name}")


if __name__ == "__main__":
    main()
