"""`tuberline`: one command per job. Commands live in their packages and are imported when they run: help stays quick.

This package is the composition root, the only place that knows the other packages.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from types import FrameType

from cyclopts import App, Group

from conveyor import __version__
from conveyor.errors import TuberlineError

_GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "Main jobs": {
        "demo": ("conveyor.cli.demo:demo", "Simulate a belt, run the whole line on it, compare with the truth."),
        "replay": ("conveyor.cli.replay:replay", "Run the whole line on a recording: ledger, summary, tubers."),
        "run": ("conveyor.cli.run:run", "Run all processes of a line on this machine, supervised."),
        "weigh": ("regressor.commands:weigh", "Weigh single clouds or depth and mask pairs; no network."),
        "score": ("aggregator.commands:score", "Compare a run with the truth: count, weights, total."),
        "simulate": ("camera_sim.commands:simulate", "Make a recording of a belt with known truth."),
    },
    "Watch a line": {
        "status": ("conveyor.cli.status:status", "Totals and nodes of a running line, once."),
        "top": ("conveyor.cli.top:top", "The same, live."),
        "health": ("conveyor.cli.doctor:health", "Is the router, or one node, well? For probes."),
        "metrics": ("conveyor.cli.metrics:metrics", "Serve a line's counters and totals to Prometheus."),
        "graph": ("conveyor.cli.graph:graph", "Who runs where and sends what to whom, live."),
        "watch": ("viewer.commands:watch", "Watch a running line: Rerun's window or a web page."),
        "page": ("viewer.page.command:page", "The operator's page: load, belt, cameras, alarms, in a browser."),
        "audit": ("aggregator.commands:audit", "The balance sheet of a run: nothing lost silently."),
        "ledger": ("aggregator.commands:ledger", "Check, repair or export a ledger."),
    },
    "Nodes of a line": {
        "router": ("conveyor.cli.router:router", "The Zenoh router of a line."),
        "camera": ("camera_sim.commands:camera", "Publish the frames of one camera."),
        "segmenter": ("segmenter.commands:segmenter", "Find and follow tubers in one camera's frames."),
        "regressor": ("regressor.commands:regressor", "Weigh views; any number, anywhere."),
        "aggregator": ("aggregator.commands:aggregator", "Count tubers once and keep the ledger."),
        "viewer": ("viewer.commands:viewer", "Show the line in Rerun: a file or a live hub."),
        "recorder": ("camera_sim.commands:recorder", "Record a line's frames to MCAP."),
    },
    "Recordings": {
        "info": ("camera_sim.commands:info", "Describe a recording and warn of its traps."),
        "convert": ("camera_sim.commands:convert", "Convert a recording, lossless."),
        "recover": ("camera_sim.commands:recover", "Mend an MCAP file whose writer was killed."),
        "simulate-views": ("camera_sim.commands:simulate_views", "Make single views with known weights, for training."),
        "simulate-belts": (
            "camera_sim.commands_belts:simulate_belts",
            "Make labelled frames of belts, for train-eyes.",
        ),
        "segment": ("segmenter.commands:segment", "Segment a recording and draw what was found."),
        "evaluate-segmentation": ("segmenter.commands:evaluate_segmentation", "Score masks against a recording's own."),
    },
    "Model": {
        "train": ("regressor.commands:train", "Train PointRAFT."),
        "cut-portraits": ("segmenter.learn.commands:cut_portraits", "Cut belts into what train-eyes learns from."),
        "train-eyes": (
            "segmenter.learn.commands:train_eyes",
            "Train the segmenter's network to tell clods from tubers.",
        ),
        "evaluate": ("regressor.commands:evaluate", "Evaluate weights and baselines on views with known weights."),
        "ablate": ("regressor.commands_study:ablate", "Train or load the paper's ablations and compare them."),
        "search": ("regressor.commands_study:search", "Search for a recipe with Optuna."),
        "split": ("regressor.commands_study:split", "Share tubers out over training, validation and test."),
        "drift": ("regressor.commands_study:drift", "Evaluate weights on views that drift from their training."),
        "calibrate-interval": ("regressor.commands_study:calibrate_interval", "Calibrate saved weights' intervals."),
        "evaluation-page": ("regressor.commands_study:evaluation_page", "Make the page of results from saved ones."),
        "export": ("regressor.commands:export", "Export the network to ONNX."),
        "weights": ("regressor.commands_weights:weights", "The weights of a running line: list, change, go back."),
        "import-checkpoint": ("regressor.commands:import_checkpoint", "Take over the authors' checkpoint."),
    },
    "Set up": {
        "calibrate": ("conveyor.cli.calibrate:calibrate", "Measure the geometry of a line."),
        "config": ("conveyor.cli.config:config", "Check, show or explain a line's configuration."),
        "topics": ("conveyor.cli.topics:topics", "The table of topics."),
        "certs": ("conveyor.cli.certs:certs", "A site's own certificates, one per node."),
        "access": ("conveyor.cli.access:access", "Who may do what: the router's rules, from the table of topics."),
        "doctor": ("conveyor.cli.doctor:doctor", "What is wrong with a line or this machine, and how to mend it."),
        "bundle": ("conveyor.cli.doctor:bundle", "Pack what a helper needs to see; no private keys."),
    },
}


def build_app() -> App:
    """The command tree, with nothing imported yet."""
    app = App(
        name="tuberline",
        help="Counts and weighs every potato on a harvester's conveyor, from depth cameras.",
        version=__version__,
        help_on_error=False,
    )
    for order, (title, commands) in enumerate(_GROUPS.items()):
        group = Group(title, sort_key=order)
        for name, (target, about) in commands.items():
            app.command(target, name=name, help=about, group=group)
    return app


def main() -> None:
    """Entry point: a TuberlineError's text goes to stderr, its exit code to the shell; bugs keep their traceback."""
    from conveyor.logs import setup_logs
    from conveyor.orphan import watch_supervisor

    setup_logs()
    signal.signal(signal.SIGTERM, _leave)
    watch_supervisor()
    code = _run()
    if "zenoh" in sys.modules:
        # The interpreter's goodbye can wait for ever for a Zenoh thread that wants to call back into it.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _leave(number: int, _frame: FrameType | None) -> None:
    """Leave by an exception, so that a command stops the processes it started; nodes have handlers of their own."""
    raise SystemExit(128 + number)


def _run() -> int:
    """Run the command line; returns the exit code."""
    try:
        build_app()()
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else int(done.code is not None)
    except TuberlineError as error:
        sys.stderr.write(f"tuberline: {error}\n")
        return error.exit_code
    except BrokenPipeError:
        return 1
    except KeyboardInterrupt:
        return 130
    except Exception:
        traceback.print_exc()
        return 1
    return 0


if __name__ == "__main__":
    main()
