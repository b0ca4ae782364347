"""The paper's printed results: the only results in this package that are not computed."""

MERIT = {
    "EF-FDI": {"EF-FDI": 0, "No FT": -6, "PL": 8, "SER FT": 8},
    "No FT": {"EF-FDI": 6, "No FT": 0, "PL": 8, "SER FT": 8},
    "PL": {"EF-FDI": -8, "No FT": -8, "PL": 0, "SER FT": -5},
    "SER FT": {"EF-FDI": -8, "No FT": -8, "PL": 5, "SER FT": 0},
}
"""Table 2, row -> column -> count: won minus lost tests of the column's technique against the row's."""

TOTAL_MERIT = {"EF-FDI": -10, "No FT": -22, "PL": 21, "SER FT": 11}
"""The last row of table 2, the sums of its columns."""

AUC = {"SER": 0.873, "beta": 0.907}
"""Table 3: area under the receiver operating characteristic on the test part."""

ARM = {
    "none": {"faulty": 0.0036, "healthy": 0.0020},
    "implicit": {"faulty": 5.422e-5, "healthy": 4.527e-5},
    "explicit": {"faulty": 6.097e-5, "healthy": 4.134e-5},
    "deterministic": {"faulty": 0.5946e-5, "healthy": 0.3579e-5},
}
"""Table 1, in rad^2: no fault tolerance, precision learning with implicit and explicit fault detection, for joints with and
without a faulty encoder. The last row, a controller that gets the fault as an input, is from the paper's predecessor (arXiv
2109.05870)."""
