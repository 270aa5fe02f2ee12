import json
import os
import threading

from scenes.waiting import wait_for

from ltm_ros.runtime.heartbeat import Heartbeat


def test_a_turn_grows_old_and_waiting_for_work_does_not() -> None:
    heart = Heartbeat()
    executor, worker = heart.activity("executor"), heart.activity("worker")
    assert heart.look(1.0) == []
    worker.begin("Image")
    ages = []
    for _ in range(3):
        with executor.turn("callback"):
            ages.append(heart.look(1.5))
    # The executor spins, each time a new turn; that does not hide that the worker stands.
    assert ages == [[(0.0, False, "executor: callback"), (age, False, "worker: Image")] for age in (0.0, 1.5, 3.0)]
    worker.end()
    assert heart.look(100.0) == []
    worker.begin("Image")
    assert heart.look(100.0) == [(0.0, False, "worker: Image")], "a turn is as old as it was watched"
    worker.slow = True
    assert heart.look(2.0) == [(2.0, True, "worker: Image")]
    worker.begin("CameraInfo")
    assert heart.look(2.0) == [(0.0, False, "worker: CameraInfo")], "the next is not slow again"


def test_tells_its_reader_until_that_is_gone() -> None:
    heart, gone = Heartbeat(), threading.Event()
    heart.activity("start").begin("node", slow=True)
    heard, told = os.pipe()
    heart.start(told, reader_gone=gone.set)
    with os.fdopen(heard) as reader:
        told_first = {"activities": [[0.0, True, "start: node"]], "ready": []}
        assert json.loads(reader.readline()) == told_first
        heart.ready(["/ridge/north/depth", "/ridge/fuel_map"])
        while not (names := json.loads(reader.readline())["ready"]):
            assert not gone.is_set()
        assert names == ["/ridge/north/depth", "/ridge/fuel_map"]
    wait_for(gone.is_set, "the end of the reader")
    os.close(told)


def test_does_not_wait_for_a_reader_that_is_stopped() -> None:
    heart, gone = Heartbeat(), threading.Event()
    heard, told = os.pipe()
    os.set_blocking(told, False)
    while True:
        try:
            os.write(told, bytes(4096))
        except BlockingIOError:
            break
    heart.start(told, reader_gone=gone.set)
    worker = heart.activity("worker")
    worker.begin("Image")
    os.close(heard)
    wait_for(gone.is_set, "the end of the reader")
    os.close(told)
