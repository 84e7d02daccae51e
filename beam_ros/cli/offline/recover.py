"""Write a valid bag from what can be read of a damaged one; status 0 where nothing was lost."""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.offline.recovery import recover


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the damaged bag, or its file")
    parser.add_argument(
        "--to", type=Path, metavar="OUT", help="folder of the new bag (default: BAG_recovered)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    report = recover(arguments.bag, arguments.to)
    print(f"{report.target}: {report.message_count} messages over {report.duration_ns * 1e-9:.1f} s")
    if report.was_whole:
        print("nothing was amiss")
    for remark in report.remarks:
        print(f"note: {remark}")
    if report.lost:
        print(f"lost: {sum(report.lost.values())} messages")
        width = max(map(len, report.lost))
        for topic, count in report.lost.items():
            print(f"  {topic:<{width}}  {count:>8}")
    elif report.lost_bytes:
        print(f"lost: {report.lost_bytes} bytes of messages at the torn end")
    return 0 if report.is_complete else 1
