// One hole, 12 mm deep in three pecks, from 10 mm above the plate; leaves G90 on
G90
G00 Z1
G01 Z-4 F400
G00 Z1
G00 Z-3.5
G01 Z-8
G00 Z1
G00 Z-7.5
G01 Z-12
G04 P200
G00 Z10
M99
