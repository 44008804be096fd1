"""Reports: one HTML file for a fit or a diagnosis that needs nothing but a browser, not even a network."""

from sysid.report.diagnosis_page import write_diagnosis_report
from sysid.report.fit_page import write_fit_report

REPORT = "report.html"
"""Name of the report in the folder of a fit or a diagnosis."""

__all__ = ["REPORT", "write_diagnosis_report", "write_fit_report"]
