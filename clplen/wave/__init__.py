"""Light as scalar waves.

Sampled complex fields come in; the fields and mean intensities behind elements, distances and
systems go out. Rooms, each built on those before: field; elements, spectrum and propagation;
systems; coherence.
"""
