"""``bayesftc`` and ``python -m bayesftc``: the command line."""

import os
import sys
import warnings

from bayesftc._interrupt import EXIT_CODE, SENTENCE, Interrupted, ended, heard


def main() -> None:
    """Run the command line and end the process with its exit code."""
    # Matrices are small: threads of the linear algebra would wait for each other, for a second on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        with heard():
            from bayesftc.cli import app

            app(prog_name="bayesftc")
    except (Interrupted, KeyboardInterrupt) as stop:
        print(str(stop) or SENTENCE, file=sys.stderr)  # noqa: T201
        warnings.simplefilter("ignore")  # such as warnings of unfinished coroutines, after the sentence
        sys.exit(EXIT_CODE)
    finally:
        ended()


if __name__ == "__main__":
    main()
