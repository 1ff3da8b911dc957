"""The table of commands: which there are, where each is defined, and under which heading help lists it."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from cyclopts import App, Group, Parameter

from conveyor import __version__
from tuberline.cli.help import PlainHelp
from tuberline.cli.mistakes import mistake
from tuberline.cli.numbers import as_written

Commands = Mapping[str, tuple[str, str]]
"""By name: 'module:function' and what help says of it."""

GROUPS: dict[str, Commands] = {
    "Count and weigh": {
        "demo": ("tuberline.cli.demo:demo", "Simulate a belt, run the whole line on it, compare with truth."),
        "replay": ("tuberline.cli.replay:replay", "Run the whole line on a recording: ledger, summary, tubers."),
        "weigh": ("tuberline.cli.weigh:weigh", "Weigh clouds, or the objects of a frame; no line needed."),
        "score": ("tuberline.cli.score:score", "Compare a run with the truth: count, weights, total."),
        "audit": ("tuberline.cli.audit:audit", "The balance sheet of a run: nothing lost silently."),
        "export": ("tuberline.cli.export:export", "A day's report (PDF, HTML); CSV, Parquet, ISOXML for programs."),
        "sync": ("tuberline.cli.sync:sync", "Ledgers of many lines into one PostgreSQL."),
        "map": ("tuberline.cli.map:map_field", "The field's yield in t/ha, from runs and positions."),
        "ledger": ("tuberline.cli.ledger:ledger", "Check, repair or dump a ledger; totals by load, field, day."),
    },
    "Set up and run a line": {
        "init": ("tuberline.cli.init:init", "Write the file of a new line, for what it finds here."),
        "run": ("tuberline.cli.run:run", "Run all processes of a line on this machine, supervised."),
        "config": ("tuberline.cli.config:config", "Check, show or explain a line's configuration."),
        "calibrate": ("tuberline.cli.calibrate:calibrate", "Measure the belt, calibrate totals by load tickets."),
        "load": ("tuberline.cli.load:load", "Start, end, note, weigh and undo loads while a line runs."),
        "weights": ("tuberline.cli.weights:weights", "The weights of a running line: list, change, go back."),
        "certs": ("tuberline.cli.certs:certs", "A site's own certificates, one per node."),
        "doctor": ("tuberline.cli.doctor:doctor", "What is wrong with a line or this machine, how to fix it."),
    },
    "Watch a line": {
        "status": ("tuberline.cli.status:status", "Totals and nodes of a running line, once."),
        "top": ("tuberline.cli.top:top", "The same, live."),
        "watch": ("tuberline.cli.viewer:watch", "Rerun's window on a running line, or a web page."),
        "page": ("tuberline.cli.page:page", "The operator's page: load, belt, cameras, alarms, in a browser."),
    },
    "Recordings": {
        "simulate": ("tuberline.cli.simulate:simulate", "Make a recording of a belt with known truth."),
        "info": ("tuberline.cli.recordings:info", "Describe a recording and warn of its traps."),
        "import": ("tuberline.cli.import_frames:import_frames", "Make one of plain depth frames of any camera."),
        "convert": ("tuberline.cli.recordings:convert", "Convert a recording, lossless; a run for Foxglove."),
        "recover": ("tuberline.cli.recordings:recover", "Repair an MCAP file whose writer was killed."),
    },
}
"""What a user needs: one screen."""

PARTS: Commands = {
    "router": ("tuberline.cli.router:router", "The Zenoh router of a line."),
    "camera": ("tuberline.cli.camera:camera", "Publish the frames of one camera; `camera profile` judges one."),
    "segmenter": ("tuberline.cli.segmentation:segmenter", "Find and follow tubers in one camera's frames."),
    "regressor": ("tuberline.cli.nodes:regressor", "Weigh views; any number, anywhere."),
    "aggregator": ("tuberline.cli.nodes:aggregator", "Count tubers once and keep the ledger."),
    "viewer": ("tuberline.cli.viewer:viewer", "Show the line in Rerun or Foxglove: a file, or live."),
    "recorder": ("tuberline.cli.nodes:recorder", "Record a line's frames to MCAP."),
    "encoder": ("tuberline.cli.nodes:encoder", "Read the encoder on the belt's shaft."),
    "gnss": ("tuberline.cli.nodes:gnss", "Read the machine's GNSS receiver."),
    "alarms": ("tuberline.cli.alarms:alarms", "Send a line's alarms to webhooks, MQTT, mail, phones."),
    "metrics": ("tuberline.cli.metrics:metrics", "Serve a line's counters and totals to Prometheus."),
    "access": ("tuberline.cli.access:access", "Who may do what: the router's rules, from the topics."),
    "topics": ("tuberline.cli.topics:topics", "The table of topics."),
    "graph": ("tuberline.cli.graph:graph", "Who runs where and sends what to whom, live."),
    "health": ("tuberline.cli.health:health", "Is the router, or one node, well? For probes."),
    "bundle": ("tuberline.cli.doctor:bundle", "Pack what a helper needs to see; no private keys."),
}
"""The parts that `run` starts by itself, and what an integrator needs of them."""

LONG_RUNNING = {*PARTS, "run", "replay", "page", "watch", "sync"} - {"access", "topics", "graph", "health", "bundle"}
"""Commands that work unattended: a thread of theirs that fails ends them."""

LAB: Commands = {
    "train": ("tuberline.cli.train:train", "Train PointRAFT."),
    "evaluate": ("tuberline.cli.evaluate:evaluate", "Evaluate weights and baselines on views with known weights."),
    "calibrate-blend": ("tuberline.cli.calibrate_blend:calibrate_blend", "Fit volume rule and blend of saved weights."),
    "calibrate-interval": (
        "tuberline.cli.calibrate_interval:calibrate_interval",
        "Calibrate saved weights' intervals.",
    ),
    "import-checkpoint": ("tuberline.cli.checkpoints:import_checkpoint", "Take over the authors' checkpoint."),
    "export-onnx": ("tuberline.cli.checkpoints:export_onnx", "Export the network to ONNX."),
    "split": ("tuberline.cli.split:split", "Share tubers out over training, validation and test."),
    "search": ("tuberline.cli.search:search", "Search for a recipe with Optuna."),
    "ablate": ("tuberline.cli.ablate:ablate", "Train or load the paper's ablations and compare them."),
    "drift": ("tuberline.cli.drift:drift", "Evaluate weights on views that drift from training."),
    "evaluation-page": ("tuberline.cli.pages:evaluation_page", "Make the page of results from saved ones."),
    "model-card": ("tuberline.cli.pages:model_card", "Make the card of weights from saved results."),
    "simulate-views": ("tuberline.cli.simulate_views:simulate_views", "Make single views with known weights."),
    "simulate-line-views": (
        "tuberline.cli.simulate_line_views:simulate_line_views",
        "Make views as a line cuts them, with known weights.",
    ),
    "simulate-belts": ("tuberline.cli.simulate_belts:simulate_belts", "Make labelled frames for train-classifier."),
    "make-patches": ("tuberline.cli.train_classifier:make_patches", "Make the patches train-classifier learns from."),
    "train-classifier": (
        "tuberline.cli.train_classifier:train_classifier",
        "Train the network that tells clods from tubers.",
    ),
    "segment": ("tuberline.cli.segmentation:segment", "Segment a recording and draw what was found."),
    "evaluate-segmentation": (
        "tuberline.cli.segmentation:evaluate_segmentation",
        "Score masks against a recording's own.",
    ),
}
"""Training and studies."""

MORE = "More"
LISTINGS: dict[str, tuple[Commands, str]] = {
    "lab": (LAB, "List the commands for training and studies: train, evaluate, ..."),
    "parts": (PARTS, "List the parts of a line as commands: camera, router, ..."),
}
FORMER: Commands = {
    "cut-portraits": ("tuberline.cli.train_classifier:make_patches", "Now make-patches."),
    "train-eyes": ("tuberline.cli.train_classifier:train_classifier", "Now train-classifier."),
}
"""Names that commands once had: they work and are listed nowhere."""


def build_app(*, all_listed: bool = False) -> App:
    """The command tree, with nothing imported yet.

    Commands of `lab` and `parts` are commands of their own and listed by those two; `all_listed` lists them with the
    rest, for the page of commands and for completion.
    """
    app = _app("tuberline", "Counts and weighs every potato on a harvester's conveyor, from depth cameras.")
    for order, (title, commands) in enumerate(GROUPS.items()):
        _add(app, commands, group=Group(title, sort_key=order))
    more = Group(MORE, sort_key=90)
    for order, (name, (commands, about)) in enumerate(LISTINGS.items()):
        listing = _app(name, about, usage=f"Usage: tuberline [{name}] COMMAND", group=more, show=not all_listed)
        listed_group = Group("Training and studies" if name == "lab" else "Parts of a line", sort_key=50 + order)
        _add(listing, commands, group=listed_group)
        needed = {known for known in commands if any(known in group for group in GROUPS.values())}
        _add(app, {k: v for k, v in commands.items() if k not in needed}, group=listed_group, show=all_listed)
        app.command(listing)
    app.command(
        "tuberline.cli.completion:completion", name="completion", help="Tab completion for bash, zsh, fish.", group=more
    )
    _add(app, FORMER, group=more, show=False)
    app["--help"].group = app["--version"].group = (more,)
    return app


def with_own_words(app: App, words: Sequence[str]) -> App:
    """`app`, ready to help with the command that `words` name: its page says what its docstring says. The line in a
    list is shorter, and stands among its neighbours.
    """
    command = app
    if not {"--help", "-h"} & set(words):
        return app
    for word in words:
        if word.startswith("-") or word not in command:
            break
        command = command[word]
    if command is not app and command.default_command is not None:
        about = (inspect.getdoc(command.default_command) or "").split("\nParameters\n")[0]
        command.help = "\n\n".join(" ".join(part.split()) for part in about.split("\n\n")).strip() or command.help
    return app


def _app(name: str, about: str, **settings: Any) -> App:
    return App(
        name=name,
        help=about,
        **settings,
        version=__version__,
        help_on_error=False,
        help_format="plaintext",
        help_formatter=PlainHelp(),
        error_formatter=mistake,
        # A flag that is off needs no second one that leaves it off; what can be turned off says so where it is defined.
        default_parameter=Parameter(
            negative_bool=(), negative_iterable=(), show_default=_told_default, converter=as_written
        ),
    )


def _told_default(value: Any) -> str | None:
    """A default as help shows it; a flag that is off and what is not given go without saying."""
    return None if value is None or value is False or value in ((), "") else str(value)


def _add(app: App, commands: Commands, *, group: Group, show: bool = True) -> None:
    for order, (name, (target, about)) in enumerate(commands.items()):
        app.command(target, name=name, help=about, group=group, show=show, sort_key=order)
