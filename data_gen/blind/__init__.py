"""Blind captures that test the diagnosis: hidden effects, simulation, sealed labels, controls."""
