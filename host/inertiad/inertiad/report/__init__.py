# SPDX-License-Identifier: Apache-2.0
"""Reports: one page with the verdict on runs, the evidence, and the next step.

    runs -> report_data.gather() -> verdict.judge()   words
                                 -> figures, scene    drawings  -> interactive (page), printed (PNG, PDF)
                                 -> tables            text
                                                                -> page.render()
document.py joins these for runs, reproduction.py for the experiment of the source paper. Facts are computed by the
modules that own them: fit, diagnose, reader, fisher_information; cables.py adds the comparison of force sensors.
Drawings are described once (figure.py) and drawn by two renderers.
"""
