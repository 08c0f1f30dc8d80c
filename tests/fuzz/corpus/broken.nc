X
G
if(
if(1
{
}
/*
