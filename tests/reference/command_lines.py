"""The command lines in cli/README.md, from the commands themselves."""

import re
from typing import Any, Literal, get_args, get_origin

import typer

from crazychoir.cli.compute import bench
from crazychoir.cli.fly import agent, mocap, radio_owner, world
from crazychoir.cli.main import CommandGroup, app
from reference.markdown import one_line, table

PROGRAMS = {
    "crazychoir-agent": agent.app,
    "crazychoir-world": world.app,
    "crazychoir-radio": radio_owner.app,
    "crazychoir-mocap": mocap.app,
}
"""Programs of the processes of a swarm; `crazychoir run` starts them too."""


def index() -> str:
    """Return a row for each group with links to its commands."""
    rows = []
    for group, texts in _by_group().items():
        links = []
        for text in texts:
            line = text.partition("\n")[0].strip("# `")
            words = [word for word in line.split() if word.islower()]
            anchor = re.sub("[^a-z -]", "", line.lower()).replace(" ", "-")
            links.append(f"[{' '.join(words).removeprefix('crazychoir ')}](#{anchor})")
        rows.append([group, ", ".join(links)])
    return table(("group", "commands"), rows)


def pages() -> str:
    """Return all commands by group, with their arguments and options."""
    return "\n\n".join(
        text for group, texts in _by_group().items() for text in (f"## {group}", *texts)
    )


def _by_group() -> dict[str, list[str]]:
    """Return the texts of all commands by group."""
    found: dict[str, list[str]] = {group: [] for group in CommandGroup}
    top: Any = typer.main.get_command(app)
    for name, command in top.commands.items():
        found[command.rich_help_panel] += _texts(f"crazychoir {name}", command)
    for name, program in PROGRAMS.items():
        found[CommandGroup.fly] += _texts(name, typer.main.get_command(program))
    return found


def _texts(name: str, command: Any) -> list[str]:
    """Return the text of a command, or of each command of a group."""
    if name == "crazychoir bench":
        command = typer.main.get_command(bench.app)
    if getattr(command, "commands", None):
        own = _text(name, command) if command.invoke_without_command else []
        inner = command.commands.items()
        return own + [text for n, c in inner for text in _texts(f"{name} {n}", c)]
    return _text(name, command)


def _text(name: str, command: Any) -> list[str]:
    """Return the text of one command: its line, its help, its options."""
    arguments = [
        p.name.upper() if p.required else f"[{p.name.upper()}]"
        for p in command.params
        if not p.opts[0].startswith("-")
    ]
    rows = [_row(p) for p in command.params if not p.hidden and p.name != "help"]
    head = ("option", "value", "default", "meaning")
    parts = [f"### `{' '.join([name, *arguments])}`", _help(command)]
    return ["\n\n".join([*parts, table(head, rows)] if rows else parts)]


def _help(command: Any) -> str:
    """Return the help of a command, a line a paragraph."""
    paragraphs = (command.help or "").split("\n\n")
    return "\n\n".join(one_line(text) for text in paragraphs)


def _row(parameter: Any) -> list[str]:
    """Return the row of an argument or an option."""
    is_argument = not parameter.opts[0].startswith("-")
    names = (
        [parameter.name.upper()]
        if is_argument
        else parameter.opts + parameter.secondary_opts
    )
    value = "" if getattr(parameter, "is_flag", False) else _kind(parameter)
    default = parameter.default
    return [
        " ".join(f"`{name}`" for name in names),
        f"{value}, several" if parameter.multiple or parameter.nargs == -1 else value,
        _default(parameter.required, default),
        parameter.help or "",
    ]


def _kind(parameter: Any) -> str:
    """Return which values an argument or an option takes."""
    annotation = parameter.type_descriptor.annotation
    if get_origin(annotation) is Literal:
        # Python may return the values in the order of another Literal with the same ones.
        return " or ".join(f"`{value}`" for value in sorted(get_args(annotation)))
    kind = getattr(annotation, "__name__", "text")
    return WORDS.get(kind, kind)


WORDS = {"str": "text", "int": "whole number", "float": "number", "Path": "file"}
"""Words for the types of values."""


def _default(is_required: bool, value: Any) -> str:
    """Return the default of an option in words."""
    if is_required:
        return "required"
    if value is None or value is False or value in ([], ()):
        return ""
    return f"`{value}`"
