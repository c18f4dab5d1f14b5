#!/usr/bin/env bash
# distributed 2026.8.0 with tblib 3.2.2, Python 3.11: to import the scheduler changes how errors are pickled in the whole
# process, and only for classes that exist by then.
#
# Guess: an error whose class takes other arguments than its text cannot be unpickled (a process or a pool that sends it
# back fails with a TypeError), whatever else is imported.
# Seen: after `import distributed`, which calls tblib.pickling_support.install() (distributed/utils.py), such an error
# arrives as it was, with its traceback, if its class was defined before that import; of a class that is defined after
# it the TypeError stays. What a worker process sends back depends on the order of imports.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet distributed==2026.8.0 tblib==3.2.2
cat > "$folder/seen.py" <<'PYTHON'
import pickle

SOURCE = '''
class {name}(Exception):
    def __init__(self, place, number):
        super().__init__(f"{{place}} is odd: {{number}}")
'''


def sent(kind):
    try:
        raise kind("a.mat", 7)
    except kind as error:
        raised = error
    try:
        arrived = pickle.loads(pickle.dumps(raised))
    except TypeError as error:
        return f"TypeError: {error}"
    return f"{type(arrived).__name__}: {arrived}, with a traceback: {arrived.__traceback__ is not None}"


exec(SOURCE.format(name="Early"))
print("before the import:", sent(Early))
import distributed
exec(SOURCE.format(name="Late"))
print("defined before it:", sent(Early))
print("defined after it:", sent(Late))
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
before the import: TypeError: Early.__init__() missing 1 required positional argument: 'number'
defined before it: Early: a.mat is odd: 7, with a traceback: True
defined after it: TypeError: Late.__init__() missing 1 required positional argument: 'number'
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
