"""All pages, in the order in which their addresses are tried."""

from typing import Final

from service.web import (
    alarms,
    axis,
    axis_analyses,
    axis_settings,
    axis_work,
    calibrate_page,
    fleet,
    import_page,
    job_page,
    login,
    long_run,
    measurement,
    new_axis,
    stored,
    system_page,
)

PAGES: Final = (
    fleet.router,
    new_axis.router,
    import_page.router,
    calibrate_page.router,
    axis.router,
    axis_work.router,
    axis_settings.router,
    axis_analyses.router,
    stored.router,
    long_run.router,
    measurement.router,
    alarms.router,
    job_page.router,
    system_page.router,
    login.router,
)
