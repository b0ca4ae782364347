"""What the paper prints: the only results in this package that are not computed."""

MERIT = {
    "EF-FDI": {"EF-FDI": 0, "No FT": -6, "PL": 8, "SER FT": 8},
    "No FT": {"EF-FDI": 6, "No FT": 0, "PL": 8, "SER FT": 8},
    "PL": {"EF-FDI": -8, "No FT": -8, "PL": 0, "SER FT": -5},
    "SER FT": {"EF-FDI": -8, "No FT": -8, "PL": 5, "SER FT": 0},
}
"""Table 2, row -> column -> count: tests that the column's technique won against the row's, minus those that it lost."""

TOTAL_MERIT = {"EF-FDI": -10, "No FT": -22, "PL": 21, "SER FT": 11}
"""The last row of table 2, the sums of its columns."""

AUC = {"SER": 0.873, "beta": 0.907}
"""Table 3: area under the receiver operating characteristic on the test part."""
