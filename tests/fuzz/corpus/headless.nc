X
G
if(
if(0

