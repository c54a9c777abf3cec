"""How a function becomes a command: its options, its client, its output, and the check of its command line.

Imports only Typer, because `klein --help` must stay fast.
"""

import contextlib
import dataclasses
import difflib
import functools
import inspect
import logging
import sys
from collections.abc import Callable, Iterable
from typing import Annotated, Any, cast

import typer
import typer.core

Text = str | None
Many = list[str] | None
UsageError: type[Any] = typer.BadParameter.__mro__[1]  # Typer brings its own copy of click, or uses the installed one
ClickException: type[Any] = UsageError.__mro__[1]
_CLOSE = 0.75


def flag(names: str, text: str) -> Any:
    """Return an option without a value."""
    return typer.Option(*names.split(), help=text)


def option(names: str, metavar: str | None, text: str, **settings: Any) -> Any:  # Any: Typer's own settings
    """Return an option with a value; `names` are separated by spaces."""
    return typer.Option(*names.split(), metavar=metavar, help=text, **settings)


def argument(metavar: str, text: str | None = None, **settings: Any) -> Any:
    """Return a positional argument."""
    return typer.Argument(metavar=metavar, help=text, show_default=False, **settings)


def closest(typed: str, known: Iterable[str]) -> str | None:
    """Return the known name that a mistyped one most likely means; None where none is close."""
    names = [*known]
    if matches := difflib.get_close_matches(typed.lower(), names, n=1, cutoff=_CLOSE):
        return matches[0]
    longer = [name for name in names if len(typed) > 2 and name.startswith(typed)]
    shorter = [name for name in names if len(name) > 2 and typed.startswith(f"{name}-")]
    return longer[0] if len(longer) == 1 else shorter[0] if len(shorter) == 1 else None


def _explain_option(error: Any, params: Iterable[Any], ctx: typer.Context) -> None:  # Any: click's own classes
    """Raise the error for an unknown option with at most one suggestion, which is an option of this command."""
    if not (hasattr(error, "option_name") and hasattr(error, "possibilities")):
        return
    typed = str(error.option_name)
    names = {option.lstrip("-"): option for param in params for option in param.opts if option.startswith("--")}
    match = closest(typed.lstrip("-").partition("=")[0], names) if typed.startswith("--") else None
    hint = f" Did you mean {names[match]}?" if match else ""
    raise UsageError(f"No such option: {typed}.{hint}", ctx)


AsJson = Annotated[bool, flag("--json", "Print JSON on stdout.")]


class StrictCommand(typer.core.TyperCommand):
    """A command that refuses an option given twice where it takes one value, instead of using the last."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # the same class, re-exported
        """Read the arguments; raise UsageError for an unknown or repeated option."""
        if not (args or ctx.resilient_parsing):
            return super().parse_args(ctx, args)
        parser, params = self.make_parser(ctx), self.get_params(ctx)
        parser.ignore_unknown_options = False
        try:
            _, _, order = parser.parse_args(args=[*args])
        except UsageError as error:
            _explain_option(error, params, ctx)
            raise
        if not ctx.resilient_parsing:
            for param in (cast(Any, param) for param in params):  # flags and counts are attributes of options alone
                takes_one = param.param_type_name == "option" and not (param.multiple or param.is_flag or param.count)
                if takes_one and (times := order.count(param)) > 1:
                    name = max(param.opts, key=len)
                    raise UsageError(f"{name} was given {times} times; this command takes one.", ctx)
        return super().parse_args(ctx, args)


class Group(typer.core.TyperGroup):
    """A group of commands that suggests the command that may have been meant, and only options that it has."""

    def __init__(self, **attributes: Any) -> None:  # Any: what Typer passes on to click
        super().__init__(**{**attributes, "suggest_commands": False})

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as above
        """Read the options of the group itself."""
        try:
            return super().parse_args(ctx, args)
        except UsageError as error:
            _explain_option(error, self.get_params(ctx), ctx)
            raise

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]  # as above
        """Return the command that the first argument names; raise UsageError with a suggestion."""
        if args and self.get_command(ctx, args[0]) is None and not ctx.resilient_parsing:
            raise UsageError(self.unknown(ctx, args), ctx)
        return super().resolve_command(ctx, args)

    def unknown(self, ctx: typer.Context, args: list[str]) -> str:
        """Return the sentence for a first argument that is no command."""
        name = args[0]
        if name.startswith("-"):
            return f"No such option: {name}."
        match = closest(name, self.list_commands(ctx))
        hint = f"Did you mean `{ctx.command_path} {match}`?" if match else f"`{ctx.command_path} --help` lists them."
        return f"No such command: {name!r}. {hint}"


class Subcommands(typer.Typer):
    """Commands with a common first word, such as `klein mission …`."""

    def __init__(self, summary: str, *, no_args_is_help: bool = True) -> None:
        super().__init__(
            help=summary,
            cls=Group,
            no_args_is_help=no_args_is_help,
            add_completion=False,
            rich_markup_mode=None,
            pretty_exceptions_enable=False,
        )

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:  # Any: Typer's own settings
        """Register a function as a command, which refuses repeated options.

        A parameter `client` is a client of the server in use. A function that returns a `render.Output` has the option
        `--json`, and its output is printed.
        """
        register = super().command(name, **{"cls": StrictCommand, **settings})

        def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
            register(_command_of(function))
            return function

        return decorate


_AS_JSON = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=AsJson)


def _command_of(function: Callable[..., Any]) -> Callable[..., None]:
    """Return what Typer calls: it connects for `client`, and prints the output."""
    signature = inspect.signature(function)
    has_output = signature.return_annotation is not None
    has_client = "client" in signature.parameters

    @functools.wraps(function)
    def run(**values: Any) -> None:  # Any: Typer calls with whatever the options are
        as_json = has_output and values.pop("as_json")
        with contextlib.ExitStack() as stack:
            if has_client:
                from kleinkram.client import connect

                values["client"] = stack.enter_context(connect())
            output = function(**values)
        if has_output:
            output.show(as_json)

    parameters = [parameter for name, parameter in signature.parameters.items() if name != "client"]
    return set_parameters(run, [*parameters, _AS_JSON] if has_output else parameters)


def with_option_groups(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command, for each parameter that is a dataclass, the options that are its fields, after its own."""
    parameters = inspect.signature(command).parameters
    kinds: dict[str, type[Any]] = {name: parameter.annotation for name, parameter in parameters.items()}
    groups = {name: kind for name, kind in kinds.items() if dataclasses.is_dataclass(kind)}
    fields = {name: inspect.signature(kind).parameters for name, kind in groups.items()}
    own = [parameter for name, parameter in parameters.items() if name not in groups]

    @functools.wraps(command)
    def run(**values: Any) -> Any:  # Any: Typer calls with whatever the options are
        chosen = {
            name: kind(**{field: values.pop(field) for field in fields[name] if field in values})
            for name, kind in groups.items()
        }
        return command(**values, **chosen)

    return set_parameters(run, [*own, *(field for group in fields.values() for field in group.values())])


def set_parameters(function: Callable[..., Any], parameters: Iterable[inspect.Parameter]) -> Callable[..., Any]:
    """Give a wrapper the parameters from which Typer makes options, those without default first."""
    keywords = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    keywords.sort(key=lambda parameter: parameter.default is not inspect.Parameter.empty)
    returned = function.__annotations__.get("return")
    function.__signature__ = inspect.Signature(keywords, return_annotation=returned)  # type: ignore[attr-defined]  # what inspect reads
    function.__annotations__ = {parameter.name: parameter.annotation for parameter in keywords}
    function.__dict__.pop("__wrapped__", None)
    return function


def take_flag(arguments: list[str], flag: str) -> bool:
    """Remove a flag wherever it is before `--`; return whether it was there."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    positions = [position for position, argument in enumerate(arguments[:end]) if argument == flag]
    for position in reversed(positions):
        del arguments[position]
    return bool(positions)


def is_json_requested() -> bool:
    """Return whether the command line contains `--json`; a failure is then printed as JSON, too."""
    end = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    return "--json" in sys.argv[:end]


def print_requests() -> None:
    """Print each request to the server on stderr: method, path, status, duration and id; neither query nor token."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("debug: %(message)s"))
    log = logging.getLogger("kleinkram.http")
    log.addHandler(handler)
    log.setLevel(logging.DEBUG)
    log.propagate = False
