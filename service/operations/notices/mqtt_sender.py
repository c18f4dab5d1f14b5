"""Publish notices of alarms through an MQTT broker, each as a CloudEvent."""

import json

from service.operations.notices.broker import Broker
from service.operations.notices.mqtt_connection import Connection, Message
from service.operations.notices.senders import CLOUD_EVENT_TYPE, Notice, NotTakenError, cloud_event


class MqttSender:
    """Publishes CloudEvents, one connection for each: alarms are rare, and a connection that was lost says so at once.

    A notice is taken when the broker has acknowledged it and somebody subscribes to it.
    """

    def __init__(self, broker: Broker, source: str) -> None:
        self.name = broker.name
        self._broker = broker
        self._source = source

    def send(self, notice: Notice) -> None:
        """Publish a notice; raises NotTakenError unless the broker acknowledges it for somebody."""
        message = Message(
            f"{self._broker.root}/{notice.subject}/alarms",
            json.dumps(cloud_event(notice, self._source), ensure_ascii=False).encode(),
            content_type=CLOUD_EVENT_TYPE,
            user_properties=(("id", str(notice.number)),),
        )
        with Connection(self._broker) as connection:
            if not connection.publish(message):
                raise NotTakenError(f"nobody subscribes to {message.topic}")
