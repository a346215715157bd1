import io

from rich.console import Console

from training.progress import progress


def shown(*, terminal):
    file = io.StringIO()
    with progress(Console(file=file, force_terminal=terminal, width=100), 50.0) as advance:
        advance("the first half", 25.0)
        advance("the rest", 25.0)
    return file.getvalue()


def test_a_pipe_gets_a_line_per_step():
    assert shown(terminal=False) == " 50 % the first half\n100 % the rest\n"


def test_a_terminal_gets_a_bar():
    text = shown(terminal=True)
    assert "\x1b[" in text
    assert "the rest" in text
    assert "100%" in text
