"""What a page shows against what a command printed: same words, nearly the same numbers."""

from __future__ import annotations

import pytest
from support.page_commands import agree, blocks_of, rewrite, run_block, started_node


@pytest.mark.parametrize(
    ('shown', 'printed'),
    [
        ('tip x 103.48 mm', 'tip  x   103.49 mm'),
        ('took ...', 'took 12 s (3 readings/s)'),
        ('named\n...\nend 3', 'named\nany\nthing\nend 3'),
        ('┃ a ━━━━━┃', '┃ a ━━━━━━━━━┃'),
        ('1.6e-07 rad', '1.7e-07 rad'),
        ('', ''),
    ],
)
def test_the_same_but_for_rounding_and_dots_agrees(shown, printed):
    assert agree(shown, printed)


@pytest.mark.parametrize(
    ('shown', 'printed'),
    [
        ('tip x 103.48 mm', 'tip x 107.48 mm'),
        ('tip x 103.48 mm', 'tip x 103.48 m'),
        ('tip x -0.12', 'tip x 0.12'),
        ('named', 'named and more'),
        ('named and more', 'named'),
        ('named ... end', 'named any end more'),
        ('... end', 'end more'),
        ('', 'something'),
        ('1.6e-07 rad', '1.6e-05 rad'),
    ],
)
def test_anything_else_does_not(shown, printed):
    assert not agree(shown, printed)


PAGE = """# A page

<!-- slow -->
```sh
echo one   # a remark
```

```console
$ echo two \\
    three
two four
```

1. in a list:

   ```sh
   echo \\
     in
   ```

<!-- not run: no robot -->
```sh
ros2 topic list
```
"""


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr('support.page_commands.ROOT', tmp_path)
    file = tmp_path / 'page.md'
    file.write_text(PAGE)
    return file


def test_blocks_have_their_remarks_and_commands(page):
    slow, console, inside, robot = blocks_of(page)
    assert (slow.remark, slow.commands, slow.line) == ('slow', ['echo one'], 3)
    assert [' '.join(command.split()) for command in console.commands] == ['echo two three']
    assert inside.content == 'echo \\\n  in\n'
    assert robot.reason_not_run == 'no robot'
    blocks = (slow, console, inside, robot)
    assert [block.is_run for block in blocks] == [True, True, True, False]


def test_what_was_printed_is_put_into_the_page(page, tmp_path):
    _, console, *_ = blocks_of(page)
    ((before, shown, printed),) = run_block(console, tmp_path)
    assert (shown, printed) == ('two four\n', 'two three\n')
    rewrite(page, before, shown, printed)
    assert page.read_text() == PAGE.replace('two four', 'two three')


def test_a_command_that_fails_is_an_error(page, tmp_path):
    page.write_text('```sh\necho begun\nfalse\necho done\n```\n')
    (block,) = blocks_of(page)
    with pytest.raises(AssertionError, match='begun'):
        run_block(block, tmp_path)


def test_a_node_is_started_the_same_way_after_pip_and_colcon():
    assert started_node('ros2 run pneunet_ros virtual_arm -h') == 'pneunet-virtual-arm -h'
    assert started_node('.venv/bin/pneunet-tracker &') == 'pneunet-tracker'
    assert started_node('ros2 topic list') is None
