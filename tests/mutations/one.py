"""One guard in this process: python -m tests.mutations.one CASE NUMBER prints as JSON what the case makes of it.

{"error": worst error, "bound": its bound} or {"raised": what the case ended with}; {"broken": why} where the code does
not so much as run, so that nothing was tried.
"""

from __future__ import annotations

import json
import sys

from tests.mutations import broken_import
from tests.mutations.guard import Guard
from tests.mutations.registry import GUARDS

NONSENSE = (SyntaxError, NameError, ImportError)
"""What a line that was broken wrongly ends with, whatever the case."""


def outcome(guard: Guard) -> dict[str, object]:
    """What the case makes of the broken code; to be asked once a process."""
    broken_import.install(guard.sources())
    from posegaussian.dags.runtime import threads

    threads.limit(1)
    from numba.core.errors import NumbaError

    from tests.hard_cases.catalogue import named

    case = named(guard.case)
    try:
        return {"error": float(case.ours()), "bound": case.bound}
    except (*NONSENSE, NumbaError) as e:
        return {"broken": f"{type(e).__name__}: {e}"}
    except Exception as e:
        return {"raised": type(e).__name__}


def main() -> None:
    name, number = sys.argv[1:]
    print(json.dumps(outcome(GUARDS[name][int(number)])))


if __name__ == "__main__":
    main()
