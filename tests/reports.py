"""Read reports as a person does: without the box, and without the ends of lines at which sentences are folded."""

import re


def unfolded(report):
    """Text of a report in one line."""
    return re.sub(r"[│┌┐└┘─\s]+", " ", report)


def section(report, head):
    """Lines of a report from one that begins with `head` to the next blank one, without the box."""
    lines = report.splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip("│ ").startswith(head))
    end = next((i for i in range(start, len(lines)) if not lines[i].strip()), len(lines))
    return lines[start:end]


def moves(result):
    """First move of every parameter by each change, by the names of both."""
    return {change.name: {name: by[0] for name, by in change.moves.items()} for change in result.changes}
