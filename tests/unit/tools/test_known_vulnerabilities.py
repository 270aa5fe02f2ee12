import json

from known_vulnerabilities import read_answer, report

ANSWER = {
    "dependencies": [
        {"name": "numpy", "version": "2.4.6", "vulns": []},
        {"name": "ros-jazzy-rclpy", "skip_reason": "Dependency not found on PyPI"},
        {
            "name": "requests",
            "version": "2.19.0",
            "vulns": [
                {"id": "PYSEC-2018-28", "fix_versions": ["2.20.0"], "aliases": [], "description": "..."},
                {"id": "PYSEC-2023-74", "fix_versions": [], "aliases": [], "description": "..."},
            ],
        },
    ],
    "fixes": [],
}


def test_vulnerabilities_fail() -> None:
    answer = read_answer(json.dumps(ANSWER))
    text, status = report(answer)
    assert status == 1
    assert text.splitlines() == [
        "requests 2.19.0: PYSEC-2018-28, mended in 2.20.0",
        "requests 2.19.0: PYSEC-2023-74, mended in no version",
        "2 packages looked up, 1 of them with known vulnerabilities",
        "nothing is known of 1 others: ros-jazzy-rclpy",
    ]


def test_no_answer_is_no_good_news() -> None:
    for output in ("", "Internal error", "[]", '{"fixes": []}', '{"dependencies": null}', '{"dependencies": [7]}'):
        answer = read_answer(output)
        assert answer.error
        assert not answer.clean
