"""What of a source computes: words may change, nothing else."""

import pytest

from slipstitch.provenance.normal_form import normal_form, without_entries

WORDS = [
    ("x = 1  # one", "x = 1"),
    ("x = (1 +\n     2)", "x = 1 + 2"),
    ("x = 'a'", 'x = "a"'),
    ('def f():\n    """Words."""\n    return 1', "def f(): return 1"),
    ('class A:\n    """Words."""\n    x = 1\n    """More."""', "class A:\n    x = 1"),
    ("raise E('no')", "raise E('not so')"),
    ("raise E('no' + x)", "raise E('never' + x)"),
    ("raise E(f'{x:.1f} is bad')", "raise E(f'bad: {x:.1f}')"),
    ("raise E('{} is bad'.format(x))", "raise E('bad: {}'.format(x))"),
    ("x = BadInput('no')", "x = BadInput('not so')"),
    ("print(f'{x} left', file=sys.stderr)", "print(f'{x} to do', file=sys.stderr)"),
    ("for x in progress(y, 'a: ', unit='b'): z(x)", "for x in progress(y, 'c: ', unit='d'): z(x)"),
    ("x = Field(1, description='a')", "x = Field(1, description='b')"),
    ("x = Field(1, description='a')", "x = Field(1)"),
    ("p.add_argument('--x', help='a')", "p.add_argument('--x', help='b', metavar='X')"),
]
COMPUTES = [
    ("x = 1", "x = 1.0"),
    ("x = 1", "x = 2"),
    ("x = 'a'", "x = b'a'"),
    ("x = a + b", "x = a - b"),
    ("x = y", "x = z"),
    ("x: int = 1", "x: float = 1"),
    ("def f(x=1): return x", "def f(x=2): return x"),
    ("@cache\ndef f(): return 1", "def f(): return 1"),
    ("print('a')", "print('b')"),
    ("print('a', file=out)", "print('b', file=out)"),
    ("print(f'{x} left', file=sys.stderr)", "print(f'{y} left', file=sys.stderr)"),
    ("x = Other('no')", "x = Other('not so')"),
    ("for x in progress(y): z(x)", "for x in progress(w): z(x)"),
    ("raise E('no', 1)", "raise E('no', 2)"),
    ("raise E('no', state='a')", "raise E('no', state='b')"),
    ("raise E(f'{x} is bad')", "raise E(f'{y} is bad')"),
    ("raise E(words['a'])", "raise E(words['b'])"),
    ("raise E('no')", "raise F('no')"),
    ("x = Field(1, ge=0)", "x = Field(1, ge=1)"),
    ("f(description='a')", "f(description='b')"),
    ("if x:\n    y()\nz()", "if x:\n    y()\n    z()"),
    ("x = [1, [2]]", "x = [[1], 2]"),
    ("from a import b", "from a import c"),
]


@pytest.mark.parametrize(("one", "other"), WORDS)
def test_words_do_not_count(one, other):
    assert normal_form(one, "one") == normal_form(other, "other")


@pytest.mark.parametrize(("one", "other"), COMPUTES)
def test_what_computes_counts(one, other):
    assert normal_form(one, "one") != normal_form(other, "other")


def test_entries_of_a_catalogue_do_not_count_but_what_reads_them_does():
    source = "SIZES: dict = {'a': 1}\ndef size(name): return SIZES[name]"
    one = without_entries(source, "one")
    assert one == without_entries(source.replace("1}", "1, 'b': 2}"), "one")
    assert one != without_entries(source.replace("[name]", "[name] + 1"), "one")
