"""Runs a command and measures its peak memory.

A small process starts the command: a child begins with the peak of its parent, which would hide that of the
command.

    python peak_memory.py FILE COMMAND...      writes the peak in MB to FILE; exits with the command's status
"""
import os
import subprocess
import sys
import tempfile


def measured(command, **options):
    """The finished process and its peak memory in MB. Options are those of `subprocess.run`."""
    with tempfile.NamedTemporaryFile("r", suffix=".txt") as file:
        done = subprocess.run([sys.executable, "-S", __file__, file.name, *command], **options)
        return done, float(file.read() or "nan")


def run(command):
    """Standard output of the command and its peak memory in MB. Ends the script if the command fails."""
    done, megabytes = measured(command, stdout=subprocess.PIPE)
    if done.returncode != 0:
        raise SystemExit(f"{command[0]} ended with status {done.returncode}")
    return done.stdout, megabytes


if __name__ == "__main__":
    child = subprocess.Popen(sys.argv[2:])
    _, status, usage = os.wait4(child.pid, 0)
    with open(sys.argv[1], "w") as file:
        file.write(str(usage.ru_maxrss / 1024))
    sys.exit(os.waitstatus_to_exitcode(status))
