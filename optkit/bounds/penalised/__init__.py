"""Bounds whose foresight is charged for by penalties of mean zero."""
