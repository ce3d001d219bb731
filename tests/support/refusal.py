"""What the command line says to input that cannot be used."""

from slipstitch.cli.main import main


def refused(capture, words, code=2) -> str:
    """Run a command that must fail, and return the one line that it says on standard error."""
    capture.readouterr()
    assert main([*map(str, words)]) == code
    said = capture.readouterr().err
    assert said.count("\n") == 1, said
    return said
