"""What the command line says to input that cannot be used."""

from slipstitch.cli.main import main


def run(command: str) -> int:
    """Run a command, without the name of the program; the exit code."""
    return main(command.split())


def refused(capture, command, code=2) -> str:
    """Run a command (or its words) that must fail; the one line that it says on standard error."""
    capture.readouterr()
    words = command.split() if isinstance(command, str) else map(str, command)
    assert main([*words]) == code
    said = capture.readouterr().err
    assert said.count("\n") == 1, said
    return said
