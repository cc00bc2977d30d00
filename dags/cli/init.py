"""The command `posegaussian init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import say
from posegaussian.dags.humanize.text import next_command
from posegaussian.storage.model.errors import ConfigError


def init(
    source: Annotated[Path, typer.Argument(help="Folder of the capture.")],
    layout: Annotated[str, typer.Option("--layout", help="Layout of the capture; auto: the one that fits.")] = "auto",
    option: Annotated[
        list[str] | None,
        typer.Option("--option", help="A choice where several files fit, as for import, key=value (may be repeated)."),
    ] = None,
    output: Annotated[Path, typer.Option("--output", help="The file to write.")] = Path("pipeline.yaml"),
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
) -> None:
    """Write a commented pipeline.yaml for a capture: what was found in it, and the settings worth touching.

    Example: posegaussian init captures/balance
    """
    from posegaussian.dags.config.settings import PACKAGED, load_configuration
    from posegaussian.dags.config.starter import starter
    from posegaussian.dags.export.output_paths import output_file
    from posegaussian.dags.importing.register import find_capture
    from posegaussian.storage.files.write import write_atomically

    output_file("init --output", output, (".yaml", ".yml"))
    if output.exists() and not force:
        raise ConfigError(f"init --output {output}: the file is there; --force writes over it, --output names another")
    capture = find_capture(layout, source, option or [], load_configuration(PACKAGED).default)
    write_atomically(output, starter(str(source), capture).encode())
    say([*capture.notes, f"settings: {output}"])
    words = [] if output == Path("pipeline.yaml") else ["--config", str(output)]
    chosen = [w for o in option or () for w in ("--option", o)]
    say([next_command("import", capture.layout, str(source), *chosen, *words)])
