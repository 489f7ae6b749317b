"""The command line. Everything heavy is imported only by the command that needs it."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

DONE, FAULT, USAGE = 0, 1, 2

EPILOG = (
    "Exit codes: 0 done; 1 a fault in the run, something was not learned, or it was stopped "
    "(devices were made safe); 2 bad scenario or usage, or hardware that is latched."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    arguments = _parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        return command(arguments)
    except BrokenPipeError:  # whoever read the output has gone, as after `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAULT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rtagent",
        description="An asyncio real-time agent runtime: schedules as data, reaction time in every run.",
        epilog=EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"rtagent {_version()}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_run(commands)
    _add_check(commands)
    _add_sweep(commands)
    _add_reproduce(commands)
    _add_list(commands)
    _add_stop(commands)
    _add_watch(commands)
    _add_view(commands)
    _add_recordings(commands)
    _add_replay(commands)
    _add_emulate(commands)
    _add_devices(commands)
    _add_calibrate(commands)
    _add_bench(commands)
    doctor = commands.add_parser("doctor", help="what this machine allows, and how late it wakes us")
    doctor.add_argument("--json", action="store_true", help="print JSON instead")
    doctor.set_defaults(command=_doctor)
    schema = commands.add_parser("schema", help="print the JSON schema of scenario files, for editors")
    schema.set_defaults(command=_schema)
    return parser


def _add_run(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    run = commands.add_parser("run", help="run a scenario", epilog=EPILOG)
    run.add_argument("scenario", help="a scenario file, such as scenarios/stopping.toml")
    run.add_argument("--clock", choices=("real", "virtual"), help="run in real time, or as fast as it goes")
    run.add_argument("--trials", type=int, metavar="N", help="each trial begins with a new agent")
    run.add_argument("--episodes", type=int, metavar="N", help="episodes of each trial")
    run.add_argument("--seed", type=int, metavar="N", help="all random streams are derived from it")
    run.add_argument("--json", metavar="FILE", help="write the results there ('-': standard output)")
    run.add_argument(
        "--trace", metavar="FILE", help="write a timeline there, for https://ui.perfetto.dev (.gz: compressed)"
    )
    run.add_argument("--checkpoint", metavar="FILE", help="keep all that the run knows there, to go on from")
    run.add_argument("--resume", action="store_true", help="go on from the checkpoint")
    run.add_argument("--record", metavar="FILE", help="record everything there, as MCAP")
    run.add_argument(
        "--human", nargs="?", const="", metavar="NAME",
        help="press the button yourself (scenarios/egg.toml); your figure is written to NAME.png and NAME.svg",
    )  # fmt: skip
    _add_data(run)
    _add_fake(run)
    run.add_argument("--quiet", action="store_true", help="print nothing but errors (and JSON, if asked for)")
    _add_set(run)
    run.set_defaults(command=_run)


def _add_sweep(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    sweep = commands.add_parser(
        "sweep", help="run a scenario with many values of some keys; a table of the results", epilog=EPILOG
    )
    sweep.add_argument("scenario")
    sweep.add_argument(
        "--over",
        action="append",
        default=[],
        metavar="KEY=A,B",
        help="run it with each of these values, such as schedule.preset=standard,reactive (may be repeated)",
    )
    sweep.add_argument("--trials", type=int, dest="runs", metavar="N", help="each combination with so many seeds")
    sweep.add_argument("--clock", choices=("real", "virtual"), help="run in real time, or as fast as it goes")
    sweep.add_argument("--out", metavar="FILE", help="the table, .csv or .parquet, in place of NAME.csv")
    _add_jobs(sweep)
    _add_data(sweep)
    _add_fake(sweep)
    sweep.add_argument("--quiet", action="store_true", help="print nothing but errors, and where the results are")
    _add_set(sweep)
    sweep.set_defaults(command=_sweep)


def _add_reproduce(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    reproduce = commands.add_parser("reproduce", help="do experiments of the thesis, and report what was found")
    reproduce.add_argument("names", nargs="*", metavar="NAME", help="experiments, or all; without any, list them")
    reproduce.add_argument("--quick", action="store_true", help="smaller: all of them in some minutes")
    reproduce.add_argument("--out", default="report", metavar="FOLDER", help="the report, in place of report")
    reproduce.add_argument("--data", metavar="FILE", help="a recording of your own, for experiments that take one")
    _add_jobs(reproduce)
    reproduce.set_defaults(command=_reproduce)


def _add_jobs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--jobs", type=int, metavar="N", help="so many at a time, each in a process of its own")
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="on the Dask cluster whose scheduler is at tcp://host:port"
    )


def _add_check(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    check = commands.add_parser("check", help="validate and explain scenarios; run nothing")
    check.add_argument("scenarios", nargs="+", metavar="scenario")
    _add_data(check)
    _add_fake(check)
    _add_set(check)
    check.set_defaults(command=_check)


def _add_stop(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    for name, command, line in (
        ("stop", _stop, "make the devices of scenarios safe, from any terminal, also after a crash"),
        ("rearm", _rearm, "tell why the devices of scenarios are latched, and let them move again"),
    ):
        parser = commands.add_parser(name, help=line)
        parser.add_argument("scenarios", nargs="+", metavar="scenario")
        _add_set(parser)
        parser.set_defaults(command=command)


def _add_watch(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    watch = commands.add_parser("watch", help="show what goes on in runs, from any other terminal")
    watch.add_argument("run", nargs="?", default="*", metavar="AGENT", help="those of this agent only")
    watch.add_argument("--once", action="store_true", help="print what is known of each run once, and end")
    add_access(watch)
    watch.set_defaults(command=_watch)


def _add_view(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    view = commands.add_parser("view", help="show what goes on in runs, on a page in the browser")
    view.add_argument("run", nargs="?", default="*", metavar="AGENT", help="those of this agent only")
    view.add_argument("--port", type=_port, default=7480, metavar="N", help="serve it there (7480; 0: any)")
    view.add_argument("--open", action="store_true", help="open it in the browser")
    add_access(view)
    view.set_defaults(command=_view)


def _add_recordings(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    info = commands.add_parser("info", help="say what is in a recording")
    info.add_argument("recording", help="what `rtagent run --record` has written")
    info.add_argument("--json", action="store_true", help="print JSON instead")
    info.set_defaults(command=_info)
    export = commands.add_parser("export", help="write a recording as tables")
    export.add_argument("recording")
    export.add_argument("--to", choices=("csv", "npz"), required=True, help="a folder of CSV files, or arrays")
    export.add_argument("--out", metavar="PATH", help="the folder or file, in place of the recording's own name")
    export.set_defaults(command=_export)
    recover = commands.add_parser("recover", help="save what can be read of a recording that was cut off")
    recover.add_argument("recording")
    recover.add_argument("--to", metavar="FILE", help="where to, in place of NAME.recovered.mcap")
    recover.set_defaults(command=_recover)


def add_access(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where telemetry is, and as whom to connect."""
    parser.add_argument("--scenario", metavar="FILE", help="connect as its table telemetry says")
    parser.add_argument("--endpoint", metavar="ENDPOINT", help="connect there, such as tls/robot.example:7448")
    parser.add_argument("--user", metavar="NAME", help="connect as this user")
    parser.add_argument("--password-file", metavar="FILE", help="with the password in this file")
    parser.add_argument("--ca", metavar="FILE", help="trust the authority with this certificate (PEM)")


def _add_list(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    groups = ("drivers", "tasks", "features", "learners", "policies", "emulators", "schedules")
    listing = commands.add_parser("list", help="list what is installed, with one line each")
    listing.add_argument("group", choices=groups)
    listing.set_defaults(command=_list)


def _add_replay(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    replay = commands.add_parser("replay", help="a recording through the same agent again, or through another one")
    replay.add_argument("recording", help="an MCAP file that `rtagent run --record` has made")
    replay.add_argument("--json", action="store_true", help="print JSON instead")
    _add_set(replay)
    replay.set_defaults(command=_replay)


def _add_emulate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    emulate = commands.add_parser("emulate", help="stand in for hardware: servos on a pseudo-terminal")
    emulate.add_argument("emulator", help="such as bento (see rtagent list emulators)")
    emulate.add_argument("arguments", nargs=argparse.REMAINDER, help="its own (see rtagent emulate bento --help)")
    emulate.set_defaults(command=_emulate)


def _add_devices(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    devices = commands.add_parser(
        "devices", help="what is plugged in, what answers there, and what is wrong with it"
    )
    devices.add_argument("--port", action="append", default=[], metavar="PATH", help="look there (may be repeated)")
    devices.add_argument("--ids", type=_ids, metavar="IDS", help="on buses look for these only, such as 1-5,9")
    devices.add_argument("--bauds", type=_bauds, metavar="RATES", help="at these rates, such as 1000000,57600")
    devices.add_argument(
        "--mend", action="store_true", help="mend what can be mended so: return delays, latched shutdowns"
    )
    devices.add_argument("--json", action="store_true", help="print JSON instead")
    devices.set_defaults(command=_devices)


def _add_calibrate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    calibrate = commands.add_parser(
        "calibrate", help="find out a device's zeros, directions and limits, limp in your hands"
    )
    calibrate.add_argument("scenario", help="a scenario whose device names a file for its calibration")
    calibrate.add_argument("--device", metavar="NAME", help="which of its devices, where several can be")
    _add_set(calibrate)
    calibrate.set_defaults(command=_calibrate)


def _add_bench(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    bench = commands.add_parser("bench", help="measure what scenarios take, and tell what got slower")
    bench.add_argument("scenarios", nargs="*", metavar="scenario", help="by default those of the baseline")
    bench.add_argument("--save", metavar="FILE", help="keep the figures there, as a baseline")
    bench.add_argument("--compare", metavar="FILE", help="compare with that baseline")
    bench.add_argument("--against", metavar="REVISION", help="compare with another git revision, in turns")
    bench.add_argument("--floor", action="store_true", help="measure the machine alone: bare wake-ups")
    bench.add_argument("--markdown", metavar="FILE", help="write a summary for a pull request there")
    bench.add_argument("--plot", metavar="FILE", help="draw the comparison there (needs matplotlib)")
    bench.add_argument("--episodes", type=int, metavar="N", help="episodes of each run")
    bench.add_argument("--rounds", type=int, metavar="N", help="rounds (10; with --against 12)")
    bench.add_argument("--processor", type=int, metavar="N", help="where to measure (the last)")
    bench.add_argument(
        "--stolen", type=float, default=0.1, metavar="X", help="share that others may have of the processor (0.1)"
    )
    bench.add_argument("--limit", type=float, metavar="X", help="times as long is allowed (2; with --against 1.1)")
    bench.add_argument("--strict", action="store_true", help="exit with 1 also where something is undecided")
    _add_set(bench)
    bench.set_defaults(command=_bench)


def _add_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", metavar="FILE", help="the recording to play: CSV, gzipped CSV or npz")


def _add_fake(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fake",
        nargs="?",
        const="wire",
        choices=("wire", "process"),
        help="fakes in place of hardware: emulated on the wire (--fake), or in the process (--fake=process)",
    )


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="set any key of the scenario, such as schedule.learn_delay=250ms (may be repeated)",
    )


def _version() -> str:
    from rtagent import __version__

    return __version__


def _run(arguments: argparse.Namespace) -> int:
    from rtagent.commands.run import run_command

    return run_command(arguments)


def _sweep(arguments: argparse.Namespace) -> int:
    from rtagent.commands.sweep import sweep_command

    return sweep_command(arguments)


def _reproduce(arguments: argparse.Namespace) -> int:
    from rtagent.commands.reproduce import reproduce_command

    return reproduce_command(arguments)


def _check(arguments: argparse.Namespace) -> int:
    from rtagent.commands.check import check_command

    return check_command(arguments)


def _stop(arguments: argparse.Namespace) -> int:
    from rtagent.commands.stop import stop_command

    return stop_command(arguments)


def _watch(arguments: argparse.Namespace) -> int:
    from rtagent.commands.watch import watch_command

    return watch_command(arguments)


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port: give a number up to 65535, or 0 for any")
    return int(text)


def _view(arguments: argparse.Namespace) -> int:
    from rtagent.commands.view import view_command

    return view_command(arguments)


def _info(arguments: argparse.Namespace) -> int:
    from rtagent.commands.recordings import info_command

    return info_command(arguments)


def _export(arguments: argparse.Namespace) -> int:
    from rtagent.commands.recordings import export_command

    return export_command(arguments)


def _recover(arguments: argparse.Namespace) -> int:
    from rtagent.commands.recordings import recover_command

    return recover_command(arguments)


def _rearm(arguments: argparse.Namespace) -> int:
    from rtagent.commands.stop import rearm_command

    return rearm_command(arguments)


def _replay(arguments: argparse.Namespace) -> int:
    from rtagent.commands.replay import replay_command

    return replay_command(arguments)


def _list(arguments: argparse.Namespace) -> int:
    from rtagent.commands.listing import list_command

    return list_command(arguments)


def _emulate(arguments: argparse.Namespace) -> int:
    from rtagent.commands.emulate import emulate_command

    return emulate_command(arguments)


def _devices(arguments: argparse.Namespace) -> int:
    from rtagent.commands.devices import devices_command

    return devices_command(arguments)


def _ids(text: str) -> Sequence[int]:
    from rtagent.commands.devices import ids

    return ids(text)


def _bauds(text: str) -> Sequence[int]:
    from rtagent.commands.devices import bauds

    return bauds(text)


def _calibrate(arguments: argparse.Namespace) -> int:
    from rtagent.commands.calibrate import calibrate_command

    return calibrate_command(arguments)


def _bench(arguments: argparse.Namespace) -> int:
    from rtagent.commands.bench import bench_command

    return bench_command(arguments)


def _doctor(arguments: argparse.Namespace) -> int:
    from rtagent.commands.doctor import doctor_command

    return doctor_command(arguments)


def _schema(arguments: argparse.Namespace) -> int:
    import json

    from rtagent.scenario import json_schema

    sys.stdout.write(json.dumps(json_schema(), indent=2) + "\n")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
