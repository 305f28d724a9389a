"""Planar pushing: poses, object contexts, images and the tensors of push models, in SI units.

``poses`` has frames, angles and reach, and ``contexts`` has objects as descriptor, indicator or visual context.
``sides`` has the geometry of Omnipush's objects, and ``outlines`` has objects of any shape as polygons.
``first_contact`` finds where a push meets one, and ``mechanics`` predicts where it ends up. ``support`` finds the
points on which an object rests, and ``shape_context`` turns an outline and its body into tensors. ``image_files`` opens
PNG, JPEG and WebP as containers, ``images`` turns a picture into a visual context, and ``image_quality`` judges the
result. ``onnx_interface`` lists the tensors of a push model, and ``gates`` tests a model against the physics and hands
both to a registry. Calls point downward: this package imports ``service.model``, ``service.turns`` and
``service.errors`` only.
"""
