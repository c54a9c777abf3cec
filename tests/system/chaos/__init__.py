"""The fault rig: what kills, fills, cuts and sets wrong. It drives real processes; tests say what must hold after."""
