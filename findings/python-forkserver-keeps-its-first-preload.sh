#!/usr/bin/env bash
# Python 3.11, multiprocessing: the fork server is one for the whole process, and what it has imported is what whoever
# started it first had asked for.
#
# Guess: `set_forkserver_preload` is a method of a context, so that each context has a server with its own modules; or it
# takes effect for processes that are started after the call, as its documentation says nothing of a first one.
# Seen: all contexts share one server. Once any code of the process has started it, another list is taken without an
# error or a warning, and is not used: processes that are started after it import the modules anew, each for itself.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
cat > "$folder/seen.py" <<'PYTHON'
import multiprocessing
import sys


def is_there(name, answer):
    answer.put(name in sys.modules)


def asked(context, name):
    answer = context.SimpleQueue()
    process = context.Process(target=is_there, args=(name, answer))
    process.start()
    process.join()
    return answer.get()


if __name__ == "__main__":
    early, late = (multiprocessing.get_context("forkserver") for _ in range(2))
    early.set_forkserver_preload(["wave"])
    print("of the first list, wave is there:", asked(early, "wave"))
    late.set_forkserver_preload(["tabnanny"])
    print("of the second list, tabnanny is there:", asked(late, "tabnanny"))
    print("of the second list, wave is there:", asked(late, "wave"))
PYTHON
"${PYTHON:-python3.11}" -W error "$folder/seen.py" > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
of the first list, wave is there: True
of the second list, tabnanny is there: False
of the second list, wave is there: True
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
