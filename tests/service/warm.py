"""What a service reads and compiles when it is first asked for it, once for all that are forked from this process."""

import monitor_core.effects
import monitor_core.models  # noqa: F401 - of the page of a new axis
from service.web.site import environment

for name in environment.list_templates():
    environment.get_template(name)
