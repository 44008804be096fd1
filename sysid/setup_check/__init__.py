"""Can this be the rig? A recording against its rig and against mistakes of set-up, before anything is fitted."""
