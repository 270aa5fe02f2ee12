"""When a photo was taken: what a pose file says, the camera's clock, and the stamp of its GPS receiver."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, tzinfo
from zoneinfo import ZoneInfo

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_ros.recordings.importing.photo import Photo

_CONTRADICTION = timedelta(minutes=10)
"""Between the camera's clock and its GPS stamp, which is that of the last fix: some minutes old at times."""
_ZONES_APART = timedelta(minutes=15)
"""Time zones differ by multiples of it."""


def time_zone(name: str) -> ZoneInfo:
    """By its name in the IANA database. Raises ConfigError where it has none of that name."""
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError) as error:
        raise ConfigError(
            f"no time zone {name!r}: name one as Europe/Oslo or America/Los_Angeles (a system without a time zone "
            "database needs `pip install tzdata`)"
        ) from error


def photo_time(photo: Photo, stated: datetime | None, zone: tzinfo | None, notes: list[str]) -> datetime:
    """With its zone.

    In this order: `stated` (UTC unless it names a zone; of a capture's frame, when the capture began); what a recording
    of sensors names it by; EXIF's clock with the zone that EXIF states; the clock in `zone`; the GPS stamp, which is
    UTC; the clock as UTC. `notes` gets what was assumed, and where clock and GPS stamp contradict each other. Raises
    RecordingError where there is no date at all.
    """
    if stated is not None:
        begun = stated if stated.tzinfo is not None else stated.replace(tzinfo=UTC)
        return begun + timedelta(seconds=photo.sensed.seconds)
    if photo.sensed.stamp is not None:
        return photo.sensed.stamp
    clock, gps = photo.exif.taken, photo.exif.gps_time
    if clock is None:
        if gps is None:
            raise RecordingError(f"{photo.path} has no date: give it a `stamp` (ISO 8601) in the pose file")
        return gps
    if clock.tzinfo is None:
        if zone is None and gps is not None:
            _compare_minutes(clock, gps, notes)
            return gps
        if zone is None:
            notes.append(f"EXIF date {clock.isoformat()} has no time zone: taken as UTC; --time-zone names its own")
        elif clock.replace(tzinfo=zone).utcoffset() != clock.replace(tzinfo=zone, fold=1).utcoffset():
            notes.append(
                f"EXIF date {clock.isoformat()} falls into the hour in which the clocks of {zone} were changed: it may "
                "be an hour off"
            )
        clock = clock.replace(tzinfo=zone or UTC)
    if gps is not None and abs(clock - gps) > _CONTRADICTION:
        notes.append(
            f"EXIF date {clock.isoformat()} and the GPS stamp {gps.isoformat()} are {_span(clock - gps)} apart: taken "
            "is the date; check the camera's clock and its time zone, or give a `stamp` in a pose file"
        )
    return clock


def _compare_minutes(clock: datetime, gps: datetime, notes: list[str]) -> None:
    """A clock without a zone may differ from UTC by a zone's offset, and by nothing else."""
    apart = clock.replace(tzinfo=UTC) - gps
    rest = apart - round(apart / _ZONES_APART) * _ZONES_APART
    if abs(apart) > timedelta(hours=14, minutes=10) or abs(rest) > timedelta(minutes=5):
        notes.append(
            f"EXIF date {clock.isoformat()} (no time zone) and the GPS stamp {gps.isoformat()} are {_span(apart)} "
            "apart, which is no time zone: taken is the GPS stamp; check the camera's clock"
        )


def _span(apart: timedelta) -> str:
    minutes = round(abs(apart).total_seconds() / 60)
    return (
        f"{minutes // 1440} d {minutes % 1440 // 60} h" if minutes >= 1440 else f"{minutes // 60} h {minutes % 60} min"
    )
