"""Adaptation of the shipped networks to a recording's rig, by simulated frames of that rig."""
