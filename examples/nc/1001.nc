// To the tool change position; leaves G90 on
G90
G00 Z115
G00 X-40 Y200
G04 X0.1
M99
