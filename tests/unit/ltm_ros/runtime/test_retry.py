from ltm_ros.runtime.retry import Backoff


def test_the_pause_doubles_up_to_its_limit_and_begins_anew_after_a_success() -> None:
    backoff = Backoff(1.0, 60.0)
    assert [backoff.failed() for _ in range(8)] == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    backoff.succeeded()
    assert backoff.failed() == 1.0
    backoff.passed(0.9)
    assert not backoff.due
    backoff.passed(0.2)
    assert backoff.due
