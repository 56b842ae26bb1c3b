"""The tracker's parts: `motion` predicts, `overlap` votes, `assignment` pairs, `fusion` updates, `table` remembers."""
