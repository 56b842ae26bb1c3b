"""The tracker's parts: `prediction`, `overlap` votes, `pairing`, `guided` search, `correction`; `table` remembers."""
