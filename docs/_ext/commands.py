"""The reference of the command line, written from the commands themselves."""

from __future__ import annotations

from typing import Any

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from optkit.cli import app as optkit_app


def of_parameter(parameter: Any) -> nodes.definition_list_item:
    """Name, help and default of one argument or option."""
    option = parameter.param_type_name == "option"
    names = [*parameter.opts, *parameter.secondary_opts] if option else [parameter.name.upper()]
    term = nodes.term("", "", nodes.literal("", ", ".join(names)))
    notes = ["required"] if parameter.required else []
    if option and parameter.default not in (None, False) and not callable(parameter.default):
        notes.append(f"default {parameter.default}")
    if option and parameter.multiple:
        notes.append("may be repeated")
    said = (parameter.help or "").replace("; repeatable", "")
    text = f"{said} ({'; '.join(notes)})" if notes else said
    return nodes.definition_list_item("", term, nodes.definition("", nodes.paragraph(text=text)))


class Commands(SphinxDirective):
    """A section for every verb of optkit."""

    def run(self) -> list[nodes.Node]:
        """Read the commands' own help."""
        group: Any = typer.main.get_command(optkit_app)
        sections: list[nodes.Node] = []
        for name, command in group.commands.items():
            section = nodes.section(ids=[f"optkit-{name}"], names=[f"optkit {name}"])
            section += nodes.title("", "", nodes.literal("", f"optkit {name}"))
            section += [nodes.paragraph(text=" ".join(part.split())) for part in (command.help or "").split("\n\n")]
            section += nodes.definition_list("", *[of_parameter(p) for p in command.params if p.name != "help"])
            self.state.document.note_explicit_target(section)
            sections.append(section)
        return sections


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive ``optkit-commands``."""
    app.add_directive("optkit-commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
