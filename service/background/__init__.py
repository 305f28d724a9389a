"""Background work: tasks that never end by an error, threads that no end awaits, and an end that keeps its time.

``supervision`` repeats the tasks of the application and knows their health. ``threads`` has the threads of each
purpose, and ``ending`` ends the process in time. This package imports no other module of the service.
"""
