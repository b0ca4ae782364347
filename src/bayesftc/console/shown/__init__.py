"""What the page shows: strips, cards, moving pictures, and the frames that carry them."""
