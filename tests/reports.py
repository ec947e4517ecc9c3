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
