"""Networks of the paper and their baselines, as torch modules.

``push_network`` is the masked and concatenated networks, ``encoders`` encodes their contexts, and ``neural_process`` is
the attentive neural process with its ``attention``. ``contact`` finds where a tip meets an outline, and ``mechanics``
pushes any outline. ``angles`` and ``mixed_precision`` hold arithmetic, and ``methods`` lists the rows of the paper's
tables. ``familiarity`` measures how far a query is from the training data, and ``omnipush_domain`` does so for the
models of Omnipush's objects. ``shape_features`` turns shapes and their mechanics into inputs, and ``shape_network`` is
the network of any shape as it is served. Calls point downward: of the trainer, this package imports ``omnipush`` alone.
"""
