import json

import pytest
from pydantic import ValidationError
from std_msgs.msg import String

from ltm_core.base.resources import config_path
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.json_topics import JSON_TOPICS, Feature, Geometry, LocateTracks, json_schemas, label_set_to_msg
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import Topic

SCHEMAS = json.loads(config_path("json_topics.schema.json").read_text())


def test_the_shipped_schemas_are_those_of_the_models() -> None:
    """After a change: python -m ltm_msgs_py.json_topics > config/json_topics.schema.json"""
    assert json_schemas() == SCHEMAS


def test_every_string_topic_has_a_schema() -> None:
    strings = {topic.name for topic in vars(topics).values() if isinstance(topic, Topic) and topic.type is String}
    assert strings - {"prompt"} == set(JSON_TOPICS)  # a prompt is plain text


@pytest.mark.parametrize("topic", JSON_TOPICS)
def test_every_message_states_its_version(topic: str) -> None:
    assert JSON_TOPICS[topic].model_fields["version"].default == 1


def test_what_is_sent_is_valid_and_another_version_is_not() -> None:
    sent = json.loads(label_set_to_msg(LabelSet.load(), "near").data)
    assert sent["version"] == 1
    assert set(SCHEMAS["$defs"]["LabelInfo"]["properties"]) == set(sent)
    place = Feature(geometry=Geometry(type="Point", coordinates=[-117.0, 37.5]), properties={"track": 1})
    tracks = json.loads(LocateTracks(stamp_ns=5, features=[place]).to_msg().data)
    assert LocateTracks.model_validate_json(json.dumps(tracks)).features == [place]
    with pytest.raises(ValidationError):
        LocateTracks.model_validate_json(json.dumps(tracks | {"version": 2}))
