"""Runs a command and says how much memory it took at most: a small process in between, since a child begins with the peak of who starts it.

    python peak_memory.py FILE COMMAND...      writes the MB to FILE and ends as the command does
"""
import os
import subprocess
import sys
import tempfile


def run(command):
    """The command's standard output and its peak memory in MB; ends the script where the command fails."""
    with tempfile.NamedTemporaryFile("r", suffix=".txt") as file:
        done = subprocess.run([sys.executable, "-S", __file__, file.name, *command], stdout=subprocess.PIPE)
        if done.returncode != 0:
            raise SystemExit(f"{command[0]} ended with status {done.returncode}")
        return done.stdout, float(file.read())


if __name__ == "__main__":
    child = subprocess.Popen(sys.argv[2:])
    _, status, usage = os.wait4(child.pid, 0)
    with open(sys.argv[1], "w") as file:
        file.write(str(usage.ru_maxrss / 1024))
    sys.exit(os.waitstatus_to_exitcode(status))
