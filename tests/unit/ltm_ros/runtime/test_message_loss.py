"""What the numbers of messages tell of those that never came."""

from __future__ import annotations

import pytest

from ltm_ros.runtime.delivery_checks import NUMBER, UNKNOWN, LossCounter


class Topic:
    """A topic with its writers, and a counter that listens to it."""

    def __init__(self, *writers: bytes) -> None:
        self.writers = frozenset(writers)
        self.counter = LossCounter(lambda: self.writers)

    def lost(self, *numbers: int | None) -> list[int]:
        return [self.counter.lost({} if number is None else {NUMBER: number}) for number in numbers]


def test_counts_what_is_passed_over() -> None:
    assert Topic(b"a").lost(1, 2, 3, 7, 8, 10) == [0, 0, 0, 3, 0, 1]


def test_what_was_sent_before_the_first_is_not_lost() -> None:
    assert Topic(b"a").lost(41, 42, 44) == [0, 0, 1]


@pytest.mark.parametrize("first_of_the_next", [1, 4, 90])
def test_a_writer_that_comes_back_counts_anew(first_of_the_next: int) -> None:
    topic = Topic(b"a")
    assert topic.lost(1, 2, 3, 4, 5) == [0] * 5
    topic.writers = frozenset([b"b"])
    second = first_of_the_next + 1
    assert topic.lost(first_of_the_next, second, second + 3) == [0, 0, 2]


def test_several_writers_are_not_told_apart() -> None:
    assert Topic(b"a", b"b").lost(1, 50, 2, 51, 9) == [0] * 5


@pytest.mark.parametrize("number", [None, UNKNOWN])
def test_a_middleware_that_does_not_number_loses_nothing(number: int | None) -> None:
    assert Topic(b"a").lost(number, number) == [0, 0]
