"""The arena: every passivity algorithm on scenes that are hard for it, at several rates and delays.

arena_cases    which cases there are, and the figures of one
arena_store    finished cases on disk, so that an arena that was stopped goes on
rig_figures    what is measured on one rig: K-B plot, impedance, time of a step, M-width
run_arena      all of it, on one core or several
standings      one row an algorithm, ranks, who gives out energy where
arena_picture, arena_page   the pictures, and one page with them and tables that can be sorted
"""
