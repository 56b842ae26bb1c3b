"""Many recordings: what there is to do, one recording, where it runs, what became of all."""
