"""What a tower says of a frame and hears of those that it sent, sealed and checked; and what it tells of the rest."""

from __future__ import annotations

from ltm_core.base.errors import MessageError
from ltm_core.uplink.config import AGGREGATOR, UplinkConfig
from ltm_core.uplink.envelope import VERSION, AckHeader, Outcome, VotesGrid, VotesHeader, header_of, outcomes_of
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_ros.region.identity import Identity
from ltm_ros.runtime.health import Health


def sealed_votes(identity: Identity, config: UplinkConfig, grid: VotesGrid, frame: OutboxFrame) -> bytes:
    """A frame's envelope. Raises MessageError where it would be too large, ValidationError for names that cannot be
    sent."""
    header = VotesHeader(
        region=config.name,
        tower=config.tower,
        camera=frame.camera,
        stamp_ns=frame.stamp_ns,
        model=frame.model,
        grid=grid,
    )
    return identity.sealed(header.model_dump_json().encode(), frame.message)


def outcomes_heard(identity: Identity, config: UplinkConfig, content: bytes) -> list[Outcome]:
    """What an acknowledgement says. Raises MessageError on any that is not the aggregator's, for this tower."""
    envelope = identity.opened(content, AGGREGATOR)
    header = header_of(AckHeader, envelope)
    if (header.region, header.tower, header.version) != (config.name, config.tower, VERSION):
        raise MessageError(
            f"an acknowledgement is of version {header.version} for {header.tower} in {header.region}; this is "
            f"{config.tower} in {config.name}, version {VERSION}"
        )
    return outcomes_of(envelope)


def tell_what_waits(health: Health, frames: int, size: int, oldest_ns: int | None, now_ns: int, link_up: bool) -> None:
    """The gauges by which a monitoring system sees how a tower's link fares; `size`: bytes, `oldest_ns`: a stamp."""
    age_s = 0.0 if oldest_ns is None else max(0.0, (now_ns - oldest_ns) / 1e9)
    health.gauge("outbox_frames", frames)
    health.gauge("outbox_bytes", size)
    health.gauge("outbox_age_s", f"{age_s:.1f}")
    health.gauge("link_up", int(link_up))
