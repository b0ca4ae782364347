"""Commands that reproduce the paper and measure speed."""
