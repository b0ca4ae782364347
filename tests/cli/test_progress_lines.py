"""How far a command is, where stderr is no terminal."""

import time

from bayesftc.cli import output


def test_lines_come_at_their_period_and_have_the_latest_numbers(capsys):
    with output.progress_lines("tracking", period=0.1) as move:
        time.sleep(0.15)
        move(3, 12, failed="1 failed", rate="")
        time.sleep(0.1)
        move(6, 12, failed="", rate="2 runs/s")
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "tracking: preparing, after 0 s"
    assert "tracking: 3 of 12, 1 failed, after 0 s" in lines
    assert "tracking: 6 of 12, 2 runs/s, after 0 s" in lines
    time.sleep(0.15)
    assert capsys.readouterr().err == ""


def test_a_quick_command_prints_none(capsys):
    with output.progress_lines("tracking") as move:
        move(12, 12)
    assert capsys.readouterr().err == ""


def test_runs_that_are_not_shown_print_nothing(capsys):
    with output.runs_progress("Comparing", shown=False) as move:
        move(1, 2, 0)
    assert capsys.readouterr().err == ""


def test_a_first_line_is_printed_at_once(capsys):
    with output.progress_lines("tracking", "12 runs", period=10.0):
        assert capsys.readouterr().err == "tracking: 12 runs\n"
