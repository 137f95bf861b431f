"""The benchmark instance sets: fixed, described and checked by digest."""
