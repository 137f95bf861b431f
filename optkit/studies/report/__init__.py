"""What a study shows: tables, figures, and the page that holds them."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.studies.report.report import check_report as check_report
    from optkit.studies.report.report import report_files as report_files
    from optkit.studies.report.report import write_report as write_report

__all__ = ["check_report", "report_files", "write_report"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.studies.report.report": ["check_report", "report_files", "write_report"],
    },
)
